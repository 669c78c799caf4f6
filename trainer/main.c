/* oriel-train: dispatch to the sub-commands of trainer/commands.h. */
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include "trainer/commands.h"

static const struct { const char *name; int (*run)(int, char **); const char *what; } COMMANDS[] = {
    { "fit", cmd_fit, "learn a scene from a folder of photos" },
    { "sky", cmd_sky, "learn the sky decoder from panoramas and parametric skies" },
    { "eval", cmd_eval, "half-photo protocol: PSNR, SSIM, FLIP beside the baselines" },
    { "masks", cmd_masks, "sky masks, and how they agree with given ones" },
    { "report", cmd_report, "one page: curves, photos against renders, what they are made of" },
    { "plot", cmd_plot, "a table as SVG" },
    { "mesh", cmd_mesh, "a scene's surface as PLY" },
    { "bench", cmd_bench, "CPU time of encodings, MLP and optimiser" },
};
enum { N = sizeof COMMANDS / sizeof *COMMANDS };

static void usage(FILE *f)
{
    fprintf(f, "Usage: oriel-train COMMAND [options]\nTrains and measures Oriel scenes. `oriel-train COMMAND --help` tells more.\n\n");
    for (int i = 0; i < N; i++) fprintf(f, "  %-8s %s\n", COMMANDS[i].name, COMMANDS[i].what);
    fprintf(f, "\n  --help, --version\n");
}

static int finish(int code)
{
    if (!fflush(stdout) && !ferror(stdout)) return code;
    fprintf(stderr, "oriel-train: standard output: cannot write\n");
    return 1;
}

int main(int argc, char **argv)
{
    signal(SIGXFSZ, SIG_IGN);                   /* a file size limit is a write error like a full disk */
    if (argc < 2) { usage(stderr); return 2; }
    if (!strcmp(argv[1], "--help") || !strcmp(argv[1], "-h")) { usage(stdout); return finish(0); }
    if (!strcmp(argv[1], "--version")) { puts("oriel-train 0.1"); return finish(0); }
    for (int i = 0; i < N; i++) if (!strcmp(argv[1], COMMANDS[i].name)) return finish(COMMANDS[i].run(argc - 1, argv + 1));
    fprintf(stderr, "oriel-train: %s: no such command (see oriel-train --help)\n", argv[1]);
    return 2;
}
