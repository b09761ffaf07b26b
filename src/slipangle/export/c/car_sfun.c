/* A Simulink S-function (level 2) around car_block.h: one input and one output port, every CAR_DT seconds. In MATLAB:

       mex CFLAGS='$CFLAGS -std=c99' car_sfun.c @SOURCES@ */

#define S_FUNCTION_NAME car_sfun
#define S_FUNCTION_LEVEL 2

#include "simstruc.h"

#include "car_block.h"

#define WIDEST 64 /* bytes at a multiple of which its memory begins */

static car_block *block_of(SimStruct *S)
{
    uintptr_t at = (uintptr_t)ssGetDWork(S, 0);
    return (car_block *)((at + WIDEST - 1) / WIDEST * WIDEST);
}

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 0);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S))
        return;
#if CAR_BLOCK_INPUTS > 0
    if (!ssSetNumInputPorts(S, 1))
        return;
    ssSetInputPortWidth(S, 0, CAR_BLOCK_INPUTS);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 0, 1);
#else
    if (!ssSetNumInputPorts(S, 0))
        return;
#endif
    if (!ssSetNumOutputPorts(S, 1))
        return;
    ssSetOutputPortWidth(S, 0, CAR_BLOCK_OUTPUTS);
    ssSetNumSampleTimes(S, 1);
    ssSetNumDWork(S, 1);
    ssSetDWorkWidth(S, 0, (int_T)(sizeof(car_block) + WIDEST));
    ssSetDWorkDataType(S, 0, SS_UINT8);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, CAR_DT);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
    if (car_block_start(block_of(S)) != 0)
        ssSetErrorStatus(S, "car: its files were compiled with different widths of vectors");
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
#if CAR_BLOCK_INPUTS > 0
    const car_signal *in = ssGetInputPortRealSignal(S, 0);
#else
    const car_signal *in = NULL;
#endif
    car_block_step(block_of(S), ssGetT(S), in, ssGetOutputPortRealSignal(S, 0));
    (void)tid;
}

static void mdlTerminate(SimStruct *S) { (void)S; }

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
