static int read_numbers(double *to, int n)
{
    for (int i = 0; i < n; i++) {
        char word[64];
        if (scanf("%63[^,\n]%*1[,\n]", word) != 1)
            return 0;
        if (strcmp(word, "nan") == 0)
            to[i] = NAN;
        else if (sscanf(word, "%lf", &to[i]) != 1)
            return 0;
    }
    return 1;
}
