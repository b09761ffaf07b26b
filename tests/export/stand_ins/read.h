/* Numbers of a recorded drive for the stand-ins: SKIP columns, the last of which is the time, then a block's inputs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define RECORDED 4096
static double recorded[RECORDED];

static int read_line(int columns)
{
    static char word[64];
    for (int i = 0; i < columns; i++) {
        if (scanf("%63[^,\n]%*1[,\n]", word) != 1)
            return 0;
        recorded[i] = strtod(word, NULL);
    }
    return 1;
}
static int columns_of_heading(void)
{
    int columns = 1, c;
    while ((c = getchar()) != '\n' && c != EOF)
        columns += c == ',';
    return columns;
}
