/* As much of Simulink's simstruc.h, with the same names, as an S-function of level 2 asks for. */
#ifndef SIMSTRUC_H
#define SIMSTRUC_H
#include <stddef.h>
#include <stdint.h>

typedef double real_T;
typedef double time_T;
typedef int int_T;
typedef int DTypeId;
enum { SS_DOUBLE = 0, SS_UINT8 = 3 };
typedef struct {
    int_T inputs, outputs, input_width, output_width, direct, contiguous, sample_times, works, work_width;
    DTypeId work_type;
    time_T sample_time, offset, t;
    const char *error;
    real_T in[4096], out[4096];
    unsigned char *work;
} SimStruct;
#define ssSetNumSFcnParams(S, n) ((void)(S))
#define ssGetNumSFcnParams(S) ((void)(S), 0)
#define ssGetSFcnParamsCount(S) ((void)(S), 0)
#define ssSetNumInputPorts(S, n) ((S)->inputs = (n), 1)
#define ssSetInputPortWidth(S, port, n) ((S)->input_width = (n))
#define ssSetInputPortRequiredContiguous(S, port, yes) ((S)->contiguous = (yes))
#define ssSetInputPortDirectFeedThrough(S, port, yes) ((S)->direct = (yes))
#define ssSetNumOutputPorts(S, n) ((S)->outputs = (n), 1)
#define ssSetOutputPortWidth(S, port, n) ((S)->output_width = (n))
#define ssSetNumSampleTimes(S, n) ((S)->sample_times = (n))
#define ssSetSampleTime(S, i, t) ((S)->sample_time = (t))
#define ssSetOffsetTime(S, i, t) ((S)->offset = (t))
#define ssSetNumDWork(S, n) ((S)->works = (n))
#define ssSetDWorkWidth(S, i, n) ((S)->work_width = (n))
#define ssSetDWorkDataType(S, i, kind) ((S)->work_type = (kind))
#define ssGetDWork(S, i) ((void *)(S)->work)
#define ssSetErrorStatus(S, said) ((S)->error = (said))
#define ssGetInputPortRealSignal(S, port) ((const real_T *)(S)->in)
#define ssGetOutputPortRealSignal(S, port) ((S)->out)
#define ssGetT(S) ((S)->t)
#endif
