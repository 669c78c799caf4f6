/* Whole files in, atomic files out (include/oriel/image.h). */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include "oriel/image.h"

orl_err orl_file_write(const char *path, const void *bytes, size_t n)
{
    char tmp[4200];
    if (snprintf(tmp, sizeof tmp, "%s.tmp%ld", path, (long)getpid()) >= (int)sizeof tmp) return orl_fail(ORL_E_RANGE, "%s: path is too long", path);
    int fd = open(tmp, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) return orl_fail(ORL_E_IO, "%s: %s", tmp, strerror(errno));
    const char *p = bytes;
    size_t left = n;
    int bad = 0;
    while (left && !bad) {
        ssize_t k = write(fd, p, left);
        if (k < 0 && errno == EINTR) continue;
        if (k <= 0) { bad = errno ? errno : EIO; break; }
        p += k;
        left -= (size_t)k;
    }
    if (!bad && fsync(fd)) bad = errno;
    if (close(fd) && !bad) bad = errno;
    if (!bad && rename(tmp, path)) bad = errno;
    if (!bad) return ORL_OK;
    unlink(tmp);
    return orl_fail(ORL_E_IO, "%s: %s", path, strerror(bad));
}

orl_err orl_file_read(const char *path, size_t max, uint8_t **bytes, size_t *n)
{
    struct stat st;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    orl_err e = ORL_OK;
    uint8_t *p = NULL;
    size_t got = 0;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) e = orl_fail(ORL_E_IO, "%s: not a regular file", path);
    else if ((uint64_t)st.st_size > max) e = orl_fail(ORL_E_RANGE, "%s: %lld bytes, at most %zu are read", path, (long long)st.st_size, max);
    else if (!(p = malloc((size_t)st.st_size + 1))) e = orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    while (!e && got < (size_t)st.st_size) {
        ssize_t k = read(fd, p + got, (size_t)st.st_size - got);
        if (k < 0 && errno == EINTR) continue;
        if (k < 0) e = orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
        if (k <= 0) break;
        got += (size_t)k;
    }
    close(fd);
    if (e) { free(p); return e; }
    p[got] = 0;
    *bytes = p;
    *n = got;
    return ORL_OK;
}
