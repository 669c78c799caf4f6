/* The text of the last failure, per thread (include/oriel/error.h). */
#include "oriel/error.h"
#include <stdarg.h>
#include <stdio.h>

static _Thread_local char last[512];

orl_err orl_fail(orl_err code, const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(last, sizeof last, fmt, ap);
    va_end(ap);
    return code;
}

const char *orl_error_text(void) { return last; }
