/* What is skipped, by name, to be turned off: --no-skip=NAME[,NAME]... Private to the runtime. */
#ifndef RUNTIME_SKIPS_H
#define RUNTIME_SKIPS_H
#include "oriel/scene.h"
#include "oriel/view.h"

enum { ORL_SKIPS = 6 };
extern const struct orl_skip { const char *name; unsigned bit; } orl_skip_list[ORL_SKIPS];

/* text: names with commas between, NULL: all. ORL_E_RANGE names the one that is none. */
orl_err orl_skips_parse(const char *text, unsigned *out);
/* A scene whose empty bricks know no distance, so that rays cross them one by one. *bmap: the caller's to free, in place of the scene's own. ORL_E_MEMORY. */
orl_err orl_skips_crowd(orl_scene *s, int32_t **bmap);
#endif
