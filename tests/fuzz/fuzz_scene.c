/* Scene reader against arbitrary bytes: as they are, and once more with checksums made right, so that mutations reach what lies behind them.
 * libFuzzer: clang -fsanitize=fuzzer,address -DORL_LIBFUZZER. Otherwise a plain main that replays files and folders of a corpus. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/scene.h"

static uint32_t crc32_slow(const uint8_t *p, size_t n, uint32_t crc)
{
    for (crc = ~crc; n; n--) {
        crc ^= *p++;
        for (int k = 0; k < 8; k++) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

static void repair(uint8_t *b, size_t n)
{
    uint32_t count;
    uint64_t at, bytes, size = n;
    if (n < 64) return;
    memcpy(&count, b + 12, 4);
    if (count > 32 || 64 + 32 * (size_t)count > n) return;
    memcpy(b + 16, &size, 8);
    for (uint32_t i = 0; i < count; i++) {
        uint8_t *e = b + 64 + 32 * i;
        memcpy(&at, e + 8, 8);
        memcpy(&bytes, e + 16, 8);
        if (at > n || bytes > n - at) continue;
        uint32_t crc = crc32_slow(b + at, (size_t)bytes, 0);
        memcpy(e + 4, &crc, 4);
    }
    memset(b + 24, 0, 4);
    uint32_t crc = crc32_slow(b, 64 + 32 * (size_t)count, 0);
    memcpy(b + 24, &crc, 4);
}

static volatile int sink;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    uint8_t *b = aligned_alloc(64, (n + 64) & ~(size_t)63);
    if (!b) return 0;
    memcpy(b, data, n);
    for (int pass = 0; pass < 2; pass++) {
        orl_scene s;
        if (!orl_scene_parse(b, n, "fuzz", &s)) {       /* whatever is accepted can be walked */
            int sum = 0;
            size_t places = (size_t)s.nb[0] * s.nb[1] * s.nb[2];
            for (size_t i = 0; i < places; i++) {
                if (s.bmap[i] < 0) continue;
                uint32_t e = s.skin[s.bmap[i]];
                int32_t end[3] = { 8 << 12, 8 << 12, 8 << 12 }, grad[3] = { e & 1, e & 2, -1 };
                uint32_t rgb[3];
                int face = orl_skin_face(orl_skin_mask(e), grad);
                orl_skin_colour(s.albedo + (size_t)orl_skin_texture(e, face) * ORL_SKIN_TEXELS * 3, face, end, rgb);
                sum += s.sdf[(size_t)s.bmap[i] * ORL_BRICK_VERTS + 728] + (int)rgb[0];
            }
            for (uint32_t i = 0; i < s.ncodes * ORL_CODE; i++) sum += s.codes[i] > 0;
            sink = sum;
            orl_scene_close(&s);
        }
        repair(b, n);
    }
    free(b);
    return 0;
}

#ifndef ORL_LIBFUZZER
static int replay(const char *path)
{
    DIR *d = opendir(path);
    int n = 0;
    if (d) {
        char name[4096];
        for (struct dirent *e; (e = readdir(d)); ) {
            if (e->d_name[0] == '.') continue;
            snprintf(name, sizeof name, "%s/%s", path, e->d_name);
            n += replay(name);
        }
        closedir(d);
        return n;
    }
    FILE *f = fopen(path, "rb");
    if (!f) { perror(path); exit(1); }
    static uint8_t buf[1 << 22];
    size_t got = fread(buf, 1, sizeof buf, f);
    fclose(f);
    LLVMFuzzerTestOneInput(buf, got);
    return 1;
}

int main(int argc, char **argv)
{
    int n = 0;
    for (int i = 1; i < argc; i++) n += replay(argv[i]);
    printf("replayed %d\n", n);
    return 0;
}
#endif
