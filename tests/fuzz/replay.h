/* main of a fuzz target without libFuzzer (-DFUZZ_MAIN): calls replay with the bytes of each file named. */
#include <stdint.h>
#include <stdio.h>

static void replay(const uint8_t *bytes, size_t n);

int main(int argc, char **argv)
{
    static uint8_t bytes[1 << 20];
    for (int i = 1; i < argc; i++) {
        FILE *f = fopen(argv[i], "rb");
        if (!f) {
            perror(argv[i]);
            return 1;
        }
        size_t n = fread(bytes, 1, sizeof bytes, f);
        fclose(f);
        replay(bytes, n);
    }
    return 0;
}
