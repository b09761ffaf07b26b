/* Two blocks side by side, in memory at an odd place, go through the recorded drive. */
#include "read.h"

int main(void)
{
    static SimStruct blocks[2];
    int columns = columns_of_heading();
    for (int b = 0; b < 2; b++) {
        SimStruct *S = &blocks[b];
        mdlInitializeSizes(S);
        mdlInitializeSampleTimes(S);
        S->work = (unsigned char *)calloc((size_t)S->work_width + 8, 1) + 8 * b;
        mdlStart(S);
        if (S->error || S->outputs != 1 || S->works != 1 || S->work_type != SS_UINT8 || S->inputs > 1)
            return 2;
    }
    while (read_line(columns)) {
        for (int b = 0; b < 2; b++) {
            SimStruct *S = &blocks[b];
            S->t = SKIP ? recorded[SKIP - 1] : 0;
            memcpy(S->in, recorded + SKIP, sizeof(double) * (size_t)S->input_width);
            mdlOutputs(S, 0);
        }
        for (int i = 0; i < blocks[0].output_width; i++) {
            if (memcmp(&blocks[0].out[i], &blocks[1].out[i], sizeof(double)) != 0)
                return 3;
            printf(i + 1 < blocks[0].output_width ? "%.17g," : "%.17g\n", blocks[0].out[i]);
        }
    }
    mdlTerminate(&blocks[0]);
    return 0;
}
