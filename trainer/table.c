/* Lines, fields and numbers of tab-separated tables (table.h). */
#include "trainer/table.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

char *table_line(char **text)
{
    char *s = *text, *end;
    if (!s || !*s) return NULL;
    if ((end = strchr(s, '\n'))) *end++ = 0;
    *text = end;
    if (*s && s[strlen(s) - 1] == '\r') s[strlen(s) - 1] = 0;
    return s;
}

char *table_field(char **line)
{
    char *s = *line, *end = s ? strchr(s, '\t') : NULL;
    if (end) *end = 0;
    *line = end ? end + 1 : NULL;
    return s;
}

int table_number(const char *s, double *v)
{
    char *end;
    *v = strtod(s, &end);
    return end != s && !*end && isfinite(*v);
}
