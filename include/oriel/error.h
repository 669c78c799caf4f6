/* Errors. Fallible functions return orl_err; results go through out-pointers that stay untouched on failure.
 * The one-line text of the last failure of the calling thread names file, offset and field; main() prints it. */
#ifndef ORIEL_ERROR_H
#define ORIEL_ERROR_H

typedef enum {
    ORL_OK = 0,
    ORL_E_IO,          /* open, read, write, rename failed */
    ORL_E_FORMAT,      /* bytes that are not what the format says */
    ORL_E_RANGE,       /* a value outside its stated range */
    ORL_E_MEMORY,      /* no memory, or the caller's block is too small */
    ORL_E_UNSUPPORTED, /* valid, but this build or version cannot do it */
    ORL_E_DEGENERATE,  /* input that determines no answer (all sky, singular pose, no pixels) */
} orl_err;

/* Records the text for this thread and returns code, so that `return orl_fail(ORL_E_FORMAT, "%s: …", path)` reads well. */
orl_err orl_fail(orl_err code, const char *fmt, ...) __attribute__((format(printf, 2, 3)));

/* Text of this thread's last failure, never NULL, without a trailing newline. Valid until the next orl_fail. */
const char *orl_error_text(void);

#endif
