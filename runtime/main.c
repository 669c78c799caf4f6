/* oriel: the program on the board. Picks the sub-command, prints what went wrong, exits: 0 done, 1 bad input or device, 2 usage. */
#include <stdio.h>
#include <string.h>
#include "oriel/cpu.h"
#include "runtime/commands.h"

#ifndef ORIEL_VERSION
#define ORIEL_VERSION "0.1"
#endif

static const struct { const char *name, *what; int (*run)(int, char **); } COMMANDS[] = {
    { "info", "what is in a scene file", orl_cmd_info },
    { "extend", "one photo, widened", orl_cmd_extend },
    { "relight", "the scene under a chosen sky, or over a day", orl_cmd_relight },
    { "bake", "a fixed camera's views, made once for `run --view`", orl_cmd_bake },
    { "run", "camera loop: source -> widened pictures -> sink", orl_cmd_run },
    { "bench", "run time against error, per view, kernel and stage", orl_cmd_bench },
};
enum { COUNT = sizeof COMMANDS / sizeof *COMMANDS };

static void usage(FILE *f)
{
    fprintf(f, "Usage: oriel COMMAND [OPTION]...\nPaint what the lens did not catch of a known place, in the light of this moment.\n\n");
    for (int i = 0; i < COUNT; i++) fprintf(f, "  %-9s %s\n", COMMANDS[i].name, COMMANDS[i].what);
    fprintf(f, "\n  oriel COMMAND --help   options of a command\n  oriel --version        version, and what this build can do\n");
}

static int finish(int code)
{
    if (fflush(stdout) || ferror(stdout)) {
        fprintf(stderr, "oriel: standard output: cannot write\n");
        return ORL_EXIT_FAILED;
    }
    return code;
}

int main(int argc, char **argv)
{
    if (argc < 2) {
        usage(stderr);
        return ORL_EXIT_USAGE;
    }
    if (!strcmp(argv[1], "--help")) {
        usage(stdout);
        return finish(ORL_EXIT_DONE);
    }
    if (!strcmp(argv[1], "--version")) {
        printf("oriel %s\nimages: %s\nsources: replay (y4m, folder), raw (as cameras store frames)\nsinks: files, hash, y4m\ncpu: %s\n", ORIEL_VERSION, orl_image_formats(), orl_cpu_name(orl_cpu_detect()));
        return finish(ORL_EXIT_DONE);
    }
    for (int i = 0; i < COUNT; i++) {
        if (strcmp(argv[1], COMMANDS[i].name)) continue;
        int code = COMMANDS[i].run(argc - 1, argv + 1);
        if (code == ORL_EXIT_FAILED) fprintf(stderr, "oriel %s: %s\n", argv[1], orl_error_text());
        if (code == ORL_EXIT_USAGE) fprintf(stderr, "oriel %s: %s (oriel %s --help tells more)\n", argv[1], orl_error_text(), argv[1]);
        return finish(code);
    }
    fprintf(stderr, "oriel: no command '%s' (oriel --help lists them)\n", argv[1]);
    return ORL_EXIT_USAGE;
}
