typedef struct {
    Sample kept[DEEPEST + 1]; /* the last samples, for outputs that are late */
} Past;
