/* `oriel-train report`: one HTML page that shows what a fit has learned: figures, curves, ablations, the surface from outside, and photos beside their renders and what those are made of.
 * Pictures are in the page itself; nothing is fetched and nothing runs. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "trainer/commands.h"
#include "trainer/report.h"

void report_section(page *p, const char *id, const char *title) { orl_text_add(&p->body, "<h2 id=\"%s\"><a href=\"#%s\">%s</a></h2>\n", id, id, title); }

/* ---- photos ---- */

static orl_err add_photo(page *p, const orl_photo *photo, const eval_setup *setup, int half, eval_row *rows, int *n)
{
    int shown;
    if (isatty(STDERR_FILENO)) fprintf(stderr, "%s\n", photo->name);
    orl_err e = report_add_photo(p, photo, setup, half, &rows[*n], &shown);
    if (!e) *n += shown;
    return e;
}

static orl_err add_test_photos(page *p, const eval_setup *setup)
{
    orl_err e = ORL_OK;
    report_section(p, "test", "Test photos");
    orl_text_add(&p->body, "<p>They train nothing. The light of each is found on its left half; the right half is scored.</p>\n");
    for (uint32_t i = 0; !e && i < p->d->nphotos && (!p->o->limit || p->ntest < p->o->limit); i++)
        if (p->d->photos[i].test) e = add_photo(p, &p->d->photos[i], setup, 1, p->test, &p->ntest);
    return e;
}

/* Of n training photos `most`, evenly spread: the middle one of each equal share. */
static orl_err add_training_photos(page *p, const eval_setup *setup, int n, int most)
{
    orl_err e = ORL_OK;
    int k = 0, seen = 0;
    if (most > n) most = n;
    if (!most) return ORL_OK;
    report_section(p, "train", "Training photos");
    orl_text_add(&p->body, "<p>%d of %d, evenly spread. The light of each is found on the whole photo.</p>\n", most, n);
    for (uint32_t i = 0; !e && k < most; i++) {
        if (p->d->photos[i].test) continue;
        if (seen++ != (int)((2 * k + 1) * (int64_t)n / (2 * most))) continue;
        k++;
        e = add_photo(p, &p->d->photos[i], setup, 0, p->train, &p->ntrain);
    }
    if (!e && p->ntrain) orl_text_add(&p->body, "<p>Mean over these, whole photo: %.2f dB.</p>\n", eval_mean(p->train, p->ntrain).full[EVAL_FIXED].psnr);
    return e;
}

/* ---- page ---- */

static const char LEGEND[] =
    "<dl class=\"legend\">\n"
    "<dt>PSNR, SSIM, FLIP</dt><dd>How close a picture is to the photo, at 512 pixels along the longer side, in sRGB: peak signal-to-noise ratio in dB (higher is better), structural similarity (1: the same), perceived difference"
    " (0: the same). Means are means of the photos' figures.</dd>\n"
    "<dt>Right half, whole</dt><dd>What is scored. The light of a test photo is found on its left half alone, so the right half was never seen.</dd>\n"
    "<dt>Row mean, warps</dt><dd>Predictions to beat: each row's mean colour; the nearest training photo moved over by depth and matched in colour; the median of the twelve nearest.</dd>\n"
    "<dt>Training</dt><dd>Stage 1 learns the geometry by volume rendering, stage 2 base colour and light on it, on other pixels: their PSNRs are not comparable. Photometric: mean squared error. Sky mask: cross-entropy of the rays'"
    " weight. Eikonal: how far the SDF's slope is from 1. Points: distance from the SfM and stereo points, in cells. Transient share: what is taken for people and cars. Light of photos: what the photos' codes leave unexplained.</dd>\n"
    "<dt>Ablation</dt><dd>Stage 2 done again without one of its parts. Base colour, sun and other skies are measured against ground truth where there is one.</dd>\n"
    "<dt>Base colour</dt><dd>What the surface reflects, without any light.</dd>\n"
    "<dt>Normals</dt><dd>Red, green, blue are x, y and up, from -1 (dark) to 1 (bright).</dd>\n"
    "<dt>Shading</dt><dd>The light that arrives from sun, sky and ground, on white, without tone; exposed for this photo.</dd>\n"
    "<dt>Sun's visibility</dt><dd>White: the sun reaches it; black: it lies in shade, by the surface's own horizon.</dd>\n"
    "<dt>Learned shadow</dt><dd>A factor from 0 (black) to 1 (white) for what casts shadows and shows in no photo; light grey (0.73) where it says nothing.</dd>\n"
    "<dt>Depth</dt><dd>Yellow near, blue far, by logarithm.</dd>\n"
    "<dt>Sky map found</dt><dd>The sky that lights the building, without the sun, on a plan: zenith in the middle, horizon on the rim, the camera looks to the top. The ring is the sun. Azimuths count counter-clockwise"
    " from the scene's x axis.</dd>\n"
    "<dt>Tone</dt><dd>What camera and filter did to the colours: upper chips before, lower ones after; then the matrix, from 0 to 1 in r, g, b.</dd>\n"
    "</dl>\n";

static const char STYLE[] =
    ":root{color-scheme:light dark;--text:#1e293b;--strong:#0f172a;--soft:#526075;--line:#e2e8f0;--back:#fff;--card:#f8fafc;--link:#1d4ed8;--worse:#dc6b4d;--better:#2f9e77}\n"
    "@media(prefers-color-scheme:dark){:root{--text:#d5dce6;--strong:#f1f5f9;--soft:#9aa7b8;--line:#303b4b;--back:#12171f;--card:#1a212c;--link:#8ab4ff}\n"
    ".plots rect{fill:var(--card)}.plots text{fill:var(--soft)}.plots text[stroke]{fill:var(--text);stroke:var(--card)}.plots text[font-weight]{fill:var(--text)}.plots path[stroke='#e2e8f0'],.plots path[stroke='#f1f5f9']{stroke:var(--line)}}\n"
    "*{box-sizing:border-box}html{scroll-behavior:smooth}body{margin:0 auto;max-width:1320px;padding:1.5rem 1.25rem 4rem;font:16px/1.55 system-ui,-apple-system,'Segoe UI',sans-serif;color:var(--text);background:var(--back)}\n"
    "h1{font-size:1.9rem;margin:.5rem 0 0;letter-spacing:-.02em;color:var(--strong)}h2{font-size:1.3rem;margin:2.6rem 0 .9rem;padding-top:1.2rem;border-top:1px solid var(--line)}h3{font-size:1rem;margin:2.2rem 0 .6rem;overflow-wrap:anywhere}\n"
    "h2 a,h3 a{color:inherit;text-decoration:none}h2 a:hover,h3 a:hover{text-decoration:underline}small{font-weight:400;color:var(--soft)}h3 small{margin-left:.5rem}p{color:var(--soft);max-width:75ch}\n"
    "nav{display:flex;flex-wrap:wrap;gap:.3rem 1.1rem;margin:.8rem 0}nav a{color:var(--link);text-decoration:none}nav a:hover{text-decoration:underline}\n"
    ".facts{display:grid;grid-template-columns:repeat(auto-fill,minmax(150px,1fr));gap:.7rem;margin:1.4rem 0}.facts div{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:.65rem .85rem;font-size:.84rem;color:var(--soft);line-height:1.35}\n"
    ".facts b{display:block;font-size:1.2rem;color:var(--strong);font-variant-numeric:tabular-nums}.scroll{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.93rem}\n"
    "th,td{padding:.35rem .8rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}th{color:var(--soft);font-weight:500}th[colspan]{text-align:center}td:first-child,th:first-child{text-align:left}.ours td{font-weight:600}\n"
    ".ablation td b{display:block;font-weight:inherit}.bar{position:relative;width:9rem;min-width:6rem;padding:0;background:linear-gradient(var(--line),var(--line)) center/1px 100% no-repeat}\n"
    ".bar i{position:absolute;top:calc(50% - .45rem);height:.9rem;border-radius:2px}.worse{right:50%;background:var(--worse)}.better{left:50%;background:var(--better)}\n"
    ".grid{display:grid;gap:.75rem;margin-bottom:.75rem;align-items:start}.three{grid-template-columns:repeat(3,1fr)}.six{grid-template-columns:repeat(6,1fr)}figure{margin:0}img{width:100%;height:auto;border-radius:5px;display:block;background:var(--card)}\n"
    "figcaption{font-size:.78rem;color:var(--soft);margin-top:.25rem}.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,400px),1fr));gap:1rem}.plots svg{width:100%;height:auto;border:1px solid var(--line);border-radius:8px}\n"
    ".light{display:grid;grid-template-columns:180px 1fr;gap:1.25rem;align-items:start}.light img{border-radius:50%}dl{margin:0;font-size:.9rem;display:grid;grid-template-columns:auto 1fr;gap:.35rem .9rem}dt{color:var(--soft)}dd{margin:0}\n"
    ".legend{max-width:110ch}.chip{display:inline-block;width:1.1em;height:1.1em;border-radius:3px;vertical-align:-.2em;margin-right:.4em;border:1px solid var(--line)}\n"
    ".tone{display:block;margin:.3rem 0;line-height:0}.tone span{display:block}.tone i{display:inline-block;width:2.2rem;height:1.1rem}code{white-space:pre-line;font-size:.82rem;color:var(--soft);font-variant-numeric:tabular-nums}\n"
    "@media(max-width:760px){.six{grid-template-columns:repeat(3,1fr)}.three{grid-template-columns:repeat(2,1fr)}.light{grid-template-columns:1fr}.light figure{max-width:180px}th,td{padding:.3rem .45rem}.ablation td:first-child{min-width:8.5rem;white-space:normal}.bar{min-width:4rem;width:4rem}dl{grid-template-columns:1fr}dt{margin-top:.4rem}}\n"
    "@media print{article{break-inside:avoid}}";

static void add_head(page *p, orl_text *out, int train)
{
    static const struct { const char *id, *title; } LINKS[] = { { "scores", "Scores" }, { "training", "Training" }, { "ablation", "Ablation" }, { "surface", "Surface" }, { "skies", "Skies" }, { "test", "Test photos" }, { "train", "Training photos" },
                                                                { "legend", "What the figures mean" } };
    orl_text_add(out, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>");
    orl_text_escape(out, p->d->name);
    orl_text_add(out, ": Oriel report</title>\n<style>\n%s\n</style>\n</head>\n<body>\n<h1>", STYLE);
    orl_text_escape(out, p->d->name);
    orl_text_add(out, "</h1>\n<p>What Oriel has learned from %d photos.</p>\n<nav>\n", train);
    for (size_t i = 0; p->body.s && i < sizeof LINKS / sizeof *LINKS; i++) {
        char id[40];
        snprintf(id, sizeof id, "<h2 id=\"%s\">", LINKS[i].id);
        if (strstr(p->body.s, id)) orl_text_add(out, "<a href=\"#%s\">%s</a>\n", LINKS[i].id, LINKS[i].title);
    }
    orl_text_add(out, "</nav>\n");
}

/* Figures stand before the photos that they are taken from: the sections are made apart and put in their order at the end. */
static orl_err make(page *p)
{
    const report_options *o = p->o;
    baselines base = { 0 };
    figure f[TRUTH_FIGURES];
    orl_text photos, out = { 0 };
    int n = 0, test = 0;
    for (uint32_t i = 0; i < p->d->nphotos; i++) test += p->d->photos[i].test;
    int train = (int)p->d->nphotos - test;
    orl_err e = baselines_open(p->d, REPORT_SCORED, &base);
    eval_setup setup = { .scene = p->s, .model = p->model, .base = &base, .cpu = orl_cpu_detect(), .threads = o->threads };
    if (!e) e = truth_geometry(p->d, p->s, &(truth_options){ .checkpoint = p->head ? o->checkpoint : NULL, .threads = o->threads }, f, &n);
    if (!e) e = report_add_outside(p);
    if (!e) e = report_add_skies(p);
    if (!e && test) e = add_test_photos(p, &setup);
    setup.base = NULL;              /* what trained the scene needs no comparison */
    setup.model = NULL;
    if (!e) e = add_training_photos(p, &setup, train, o->train);
    photos = p->body;
    p->body = (orl_text){ 0 };
    if (!e) {
        report_add_facts(p, train, test, f, n);
        report_add_scores(p);
        report_add_curves(p);
        report_add_ablation(p);
        orl_text_add(&p->body, "%s", photos.s ? photos.s : "");
        report_section(p, "legend", "What the figures mean");
        add_head(p, &out, train);
        orl_text_add(&out, "%s%s</body>\n</html>\n", p->body.s ? p->body.s : "", LEGEND);
        out.failed |= p->body.failed | photos.failed;
        e = orl_text_write(&out, o->output);
    }
    if (!e) printf("%s: %d test and %d training photos, %.1f MB\n", o->output, p->ntest, p->ntrain, (double)out.n * 1e-6);
    orl_text_free(&photos);
    orl_text_free(&out);
    baselines_close(&base);
    return e;
}

/* ---- command ---- */

static void warn(void *user, const char *line) { (void)user; fprintf(stderr, "%s\n", line); }

static const char HELP[] =
    "Usage: oriel-train report SCENE --scene FILE.oriel -o FILE.html [options]\n"
    "Writes one self-contained page: figures, curves, ablations, the surface from outside, and photos beside their renders and what those are made of.\n\n"
    "      --scene FILE        exported scene\n"
    "  -o, --output FILE       page to write\n"
    "      --checkpoint FILE   default: the scene's name with .ckpt appended; without it no curves and no figure on transients\n"
    "      --ablation FILE     table made by tests/ablation.sh\n"
    "      --sky FILE          a panorama (.hdr, .exr) to show the first test photo's view under; up to 12 of them\n"
    "      --limit N           the first N test photos; default: all\n"
    "      --train N           training photos shown, evenly spread; default 6\n"
    "      --threads N         default: one per core\n"
    "      --help\n";

static orl_err open_checkpoint(page *p, report_options *o, char *own, size_t bytes)
{
    FILE *f = NULL;
    if (!o->checkpoint) {
        snprintf(own, bytes, "%s.ckpt", o->scene);
        if (!access(own, R_OK)) o->checkpoint = own;
        else fprintf(stderr, "%s: no checkpoint, no curves\n", own);
    }
    if (!o->checkpoint) return ORL_OK;
    if (!(p->head = malloc(sizeof *p->head))) return orl_fail(ORL_E_MEMORY, "report: no memory");
    orl_err e = checkpoint_peek(o->checkpoint, p->head, &f);
    if (e) return e;
    fclose(f);
    return orl_model_load(o->checkpoint, &p->model);
}

static orl_err report(report_options *o)
{
    orl_dataset d = { 0 };
    orl_scene s = { 0 };
    page p = { .o = o, .d = &d, .s = &s };
    char own[4096];
    orl_err e = ORL_OK;
    if (o->ablation) e = (p.parts = malloc(sizeof *p.parts)) ? ablation_read(o->ablation, p.parts) : orl_fail(ORL_E_MEMORY, "report: no memory");
    if (!e) e = orl_dataset_open(o->dir, warn, NULL, &d);
    if (!e) e = orl_scene_open(o->scene, &s);
    if (!e && !s.nbricks) e = orl_fail(ORL_E_DEGENERATE, "%s: holds no surface", o->scene);
    if (!e) e = open_checkpoint(&p, o, own, sizeof own);
    p.test = calloc(d.nphotos + 1u, sizeof *p.test);
    p.train = calloc(d.nphotos + 1u, sizeof *p.train);
    if (!e && (!p.test || !p.train)) e = orl_fail(ORL_E_MEMORY, "report: no memory");
    if (!e) e = make(&p);
    if (p.model) orl_model_free(p.model);
    orl_text_free(&p.body);
    free(p.test);
    free(p.train);
    free(p.head);
    free(p.parts);
    orl_scene_close(&s);
    orl_dataset_free(&d);
    return e;
}

static int number(const char *name, const char *value, int lo, int hi, int *out)
{
    char *end;
    long v = strtol(value, &end, 10);
    if (end == value || *end || v < lo || v > hi) {
        fprintf(stderr, "oriel-train report: --%s %s: %d to %d\n", name, value, lo, hi);
        return 0;
    }
    *out = (int)v;
    return 1;
}

int cmd_report(int argc, char **argv)
{
    enum { SCENE = 256, CHECKPOINT, ABLATION, SKY, LIMIT, TRAIN, THREADS, MOST = 1000000 };
    static const struct option LONG[] = { { "scene", 1, 0, SCENE }, { "output", 1, 0, 'o' }, { "checkpoint", 1, 0, CHECKPOINT }, { "ablation", 1, 0, ABLATION }, { "sky", 1, 0, SKY }, { "limit", 1, 0, LIMIT }, { "train", 1, 0, TRAIN },
                                          { "threads", 1, 0, THREADS }, { "help", 0, 0, 'h' }, { 0 } };
    report_options o = { .train = 6 };
    int c;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) switch (c) {
        case SCENE: o.scene = optarg; break;
        case 'o': o.output = optarg; break;
        case CHECKPOINT: o.checkpoint = optarg; break;
        case ABLATION: o.ablation = optarg; break;
        case SKY:
            if (o.nskies == REPORT_SKIES) { fprintf(stderr, "oriel-train report: --sky %s: at most %d skies\n", optarg, REPORT_SKIES); return 2; }
            o.sky[o.nskies++] = optarg;
            break;
        case LIMIT: if (!number("limit", optarg, 1, MOST, &o.limit)) return 2; break;
        case TRAIN: if (!number("train", optarg, 0, MOST, &o.train)) return 2; break;
        case THREADS: if (!number("threads", optarg, 1, 64, &o.threads)) return 2; break;
        case 'h': fputs(HELP, stdout); return 0;
        default: fputs(HELP, stderr); return 2;
        }
    if (optind + 1 != argc || !o.scene || !o.output) { fputs(HELP, stderr); return 2; }
    o.dir = argv[optind];
    orl_err e = report(&o);
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    return e ? 1 : 0;
}
