/* Random inputs for whatever was exported, through car_block.h: near the rows of the recorded drive, which it reads, or far
   from them, NaN and infinities among them. The first argument is how many calls; COMMANDS of what comes out are commands,
   which must be finite. */

#include "racer_block.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define ROWS 200

static racer_block block;
static double rows[ROWS][SKIP + RACER_BLOCK_INPUTS], out[RACER_BLOCK_OUTPUTS];
static unsigned long long state = 1;

static double uniform(void)
{
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double odd(void)
{
    static const double values[] = {NAN,   INFINITY, -INFINITY, 1e308, -1e308, 1e200, 1e100,
                                    -1e30, 1e13,     0,         5e-324, 1e-300, -40,   9};
    return values[(int)(uniform() * 14)];
}

static int read_rows(int columns)
{
    char word[64];
    int n = 0;
    for (; n < ROWS; n++)
        for (int i = 0; i < columns; i++) {
            if (scanf("%63[^,\n]%*1[,\n]", word) != 1)
                return n;
            if (i < SKIP + RACER_BLOCK_INPUTS)
                rows[n][i] = strtod(word, NULL);
        }
    return n;
}

int main(int n, char **words)
{
    int columns = 1, c;
    while ((c = getchar()) != '\n' && c != EOF)
        columns += c == ',';
    int n_rows = read_rows(columns);
    long calls = n > 1 ? atol(words[1]) : 1, wrong = 0;
    for (long k = 0; k < calls; k++) {
        double in[RACER_BLOCK_INPUTS + 1], size = pow(10, 5 * uniform() - 5);
        if ((k == 0 || uniform() < 0.005) && racer_block_start(&block) != 0)
            return 2;
        for (int i = 0; i < RACER_BLOCK_INPUTS; i++)
            in[i] = rows[k % n_rows][SKIP + i] + size * (uniform() - 0.5);
        for (int poison = uniform() < 0.35 ? 1 + (int)(3 * uniform()) : 0; poison > 0; poison--)
            in[(int)(uniform() * RACER_BLOCK_INPUTS)] = odd();
        double t = uniform() < 0.01 ? odd() : 0.02 * (double)k + (uniform() < 0.01 ? uniform() : 0);
        racer_block_step(&block, t, in, out);
        for (int i = 0; i < COMMANDS; i++)
            wrong += !(fabs(out[i]) < INFINITY);
    }
    printf("%ld calls, %ld commands that are none\n", calls, wrong);
    return wrong != 0 || n_rows == 0;
}
