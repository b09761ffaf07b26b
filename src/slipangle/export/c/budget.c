/* Calls what was exported in states harder than those of the recorded drive, which it reads: off by up to three times what
   the drive itself varies by, a tenth of them after a cold start, a twentieth with an entry that is no number.

       budget count N < drive.csv   just calls it, for what counts instructions
       budget stack N < drive.csv   bytes of stack that a call takes at most */

#include "car.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ROWS 2000
#define STACK (1 << 20)
#define PAINT 0xA5

@CALL@
static double rows[ROWS][COLUMNS], spread[COLUMNS], row[COLUMNS];
static int n_rows;
static long calls;
static unsigned long long state = 1;
static unsigned char stack[STACK] __attribute__((aligned(64))), *top;

static double uniform(void)
{
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double number(void)
{
    char word[64];
    if (scanf("%63[^,\n]%*1[,\n]", word) != 1)
        return INFINITY;
    return strcmp(word, "nan") == 0 ? NAN : atof(word);
}

static void read_drive(void)
{
    int c = scanf("%*[^\n]") + scanf("%*1[\n]"); /* names of the columns */
    for (; c == 0 && n_rows < ROWS; n_rows++) {
        for (int i = 0; i < COLUMNS + COMMANDS; i++) {
            double v = number();
            if (v > 1e300) /* the end of the file */
                c = 1;
            else if (i < COLUMNS)
                rows[n_rows][i] = v;
        }
        n_rows -= c;
    }
    for (c = 0; c < COLUMNS; c++) {
        double sum = 0, squares = 0, n = 0;
        for (int k = 0; k < n_rows; k++)
            if (rows[k][c] == rows[k][c])
                sum += rows[k][c], squares += rows[k][c] * rows[k][c], n++;
        spread[c] = n > 0 ? sqrt(fmax(squares / n - sum / n * (sum / n), 0)) + 1e-3 * fabs(sum / n) + 1e-6 : 0;
    }
}

static void *call_all(void *nothing)
{
    unsigned char here = 0;
    top = &here;
    for (long k = 0; k < calls; k++) {
        double size = 3 * pow(10, -2 * uniform());
        memcpy(row, rows[k % n_rows], sizeof row);
        for (int c = FIRST; c < COLUMNS; c++)
            row[c] += size * spread[c] * (2 * uniform() - 1);
        if (uniform() < 0.05)
            row[FIRST + (int)(uniform() * (COLUMNS - FIRST))] = NAN;
        call(row, k, k == 0 || uniform() < 0.1);
    }
    return nothing;
}

/* Bytes of its stack that a thread touches below where it calls from. */
static long touched(void)
{
    pthread_attr_t attributes;
    pthread_t thread;
    long free_ = 0;
    memset(stack, PAINT, sizeof stack);
    pthread_attr_init(&attributes);
    if (pthread_attr_setstack(&attributes, stack, sizeof stack) || pthread_create(&thread, &attributes, call_all, NULL))
        return -1;
    pthread_join(thread, NULL);
    while (free_ < STACK && stack[free_] == PAINT)
        free_++;
    return top - (stack + free_);
}

int main(int n, char **words)
{
    if (n < 3)
        return 2;
    calls = atol(words[2]);
    read_drive();
    if (n_rows == 0)
        return 2;
    if (strcmp(words[1], "stack") != 0) {
        call_all(NULL);
        return 0;
    }
    printf("%ld\n", touched());
    return 0;
}
