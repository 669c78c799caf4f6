/* Whole files in, atomic files out, checksums (include/oriel/image.h). */
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

orl_err orl_file_replace(const char *tmp, const char *path)
{
    int fd = open(tmp, O_RDWR | O_CLOEXEC), bad = fd < 0 || fsync(fd) ? errno : 0;
    if (fd >= 0 && close(fd) && !bad) bad = errno;
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

/* Eight bytes a step, little-endian; tables are small enough to make anew. */
uint32_t orl_crc32(const void *bytes, size_t n, uint32_t crc)
{
    const uint8_t *p = bytes;
    uint32_t t[8][256];
    for (uint32_t i = 0; i < 256; i++) {
        uint32_t c = i;
        for (int k = 0; k < 8; k++) c = c & 1 ? c >> 1 ^ 0xEDB88320u : c >> 1;
        t[0][i] = c;
    }
    for (int k = 1; k < 8; k++) for (int i = 0; i < 256; i++) t[k][i] = t[k - 1][i] >> 8 ^ t[0][t[k - 1][i] & 255];
    crc = ~crc;
    for (; n >= 8; n -= 8, p += 8) {
        uint32_t a, b;
        memcpy(&a, p, 4);
        memcpy(&b, p + 4, 4);
        a ^= crc;
        crc = t[7][a & 255] ^ t[6][a >> 8 & 255] ^ t[5][a >> 16 & 255] ^ t[4][a >> 24] ^ t[3][b & 255] ^ t[2][b >> 8 & 255] ^ t[1][b >> 16 & 255] ^ t[0][b >> 24];
    }
    for (; n; n--) crc = crc >> 8 ^ t[0][(crc ^ *p++) & 255];
    return ~crc;
}
