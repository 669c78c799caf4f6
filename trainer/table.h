/* Tab-separated tables, cut up in place. */
#ifndef TRAINER_TABLE_H
#define TRAINER_TABLE_H

/* Cuts the next line off *text, without its end; NULL when there is none. */
char *table_line(char **text);
/* Cuts the next field off *line; *line is NULL after the last one, and then so is the result. */
char *table_field(char **line);
/* 1 if all of s is one finite number. */
int table_number(const char *s, double *v);
#endif
