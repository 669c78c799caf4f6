/* Figures, curves and tables of the report (report.h). */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "trainer/report.h"

/* ---- figures and scores ---- */

static void add_fact(orl_text *t, const char *value, const char *what) { orl_text_add(t, "<div><b>%s</b>%s</div>\n", value, what); }

void report_add_facts(page *p, int train, int test, const figure *f, int n)
{
    static const struct { const char *key, *what, *unit; double times; int digits; } SHOW[] = {
        { "depth_median_rel", "median depth error", " %", 100, 2 }, { "normal_mean_deg", "mean normal error", "&deg;", 1, 1 }, { "sky_covered", "of the sky covered", " %", 100, 2 },
        { "sfm_heldout_median_rel", "off held-out SfM points (median)", " %", 100, 2 }, { "transient_iou", "transients found (IoU)", "", 1, 2 } };
    orl_text *t = &p->body;
    char v[64];
    orl_text_add(t, "<div class=\"facts\">\n");
    snprintf(v, sizeof v, "%d + %d", train, test);
    add_fact(t, v, "training and test photos");
    if (p->head) {
        snprintf(v, sizeof v, "%.1f min", p->head->seconds / 60);
        add_fact(t, v, "of training");
        snprintf(v, sizeof v, "%.1f min", p->head->cpu_seconds / 60);
        add_fact(t, v, "of CPU time");
    }
    snprintf(v, sizeof v, "%.1f MB", (double)p->s->map_bytes * 1e-6);
    add_fact(t, v, "scene file");
    for (int i = 0; i < n; i++)
        for (size_t k = 0; k < sizeof SHOW / sizeof *SHOW; k++)
            if (!strcmp(SHOW[k].key, f[i].key)) {
                snprintf(v, sizeof v, "%.*f%s", SHOW[k].digits, f[i].v * SHOW[k].times, SHOW[k].unit);
                add_fact(t, v, SHOW[k].what);
            }
    orl_text_add(t, "</div>\n");
}

void report_add_scores(page *p)
{
    static const char *const TITLE[EVAL_COLUMNS] = { [EVAL_FIXED] = "Oriel, fixed point", [EVAL_FLOAT] = "Oriel, float", [EVAL_ROW_MEAN] = "row mean", [EVAL_NEAREST] = "nearest photo, warped", [EVAL_MEDIAN] = "median of 12 warps" };
    eval_row mean = eval_mean(p->test, p->ntest);
    orl_text *t = &p->body;
    if (!p->ntest) return;
    report_section(p, "scores", "Scores");
    orl_text_add(t, "<div class=\"scroll\">\n<table>\n<tr><th></th><th colspan=\"3\">right half</th><th colspan=\"3\">whole photo</th></tr>\n"
                "<tr><th>mean over %d test photo%s</th><th>PSNR</th><th>SSIM</th><th>FLIP</th><th>PSNR</th><th>SSIM</th><th>FLIP</th></tr>\n", p->ntest, p->ntest > 1 ? "s" : "");
    for (int k = 0; k < EVAL_COLUMNS; k++) {
        const orl_score *r = &mean.right[k], *f = &mean.full[k];
        if (mean.has[k])
            orl_text_add(t, "<tr%s><td>%s</td><td>%.2f</td><td>%.3f</td><td>%.3f</td><td>%.2f</td><td>%.3f</td><td>%.3f</td></tr>\n", k == EVAL_FIXED ? " class=\"ours\"" : "", TITLE[k] ? TITLE[k] : EVAL_NAMES[k], r->psnr, r->ssim, r->flip,
                     f->psnr, f->ssim, f->flip);
    }
    orl_text_add(t, "</table>\n</div>\n");
}

/* ---- curves ---- */

enum { PSNR, MSE, SKY, EIKONAL, POINTS, TRANSIENT, CODES, KINDS };

void report_add_curves(page *p)
{
    const checkpoint_header *h = p->head;
    double x[LOG_ROWS], y[KINDS][LOG_ROWS];
    if (!h || h->logged < 2) return;
    int n = h->logged, first = 0, second;
    for (int i = 0; i < n; i++) {
        const log_row *r = &h->log[i];
        const double v[KINDS] = { r->psnr, pow(10, -r->psnr / 10), r->sky, r->eikonal, r->points, r->transient, r->codes_rms };
        x[i] = r->cpu_minutes;
        for (int k = 0; k < KINDS; k++) y[k][i] = v[k];
        first += r->stage < 2;
    }
    second = n - first;
    report_section(p, "training", "Training");
    orl_text_add(&p->body, "<div class=\"plots\">\n");
    const orl_plot_series psnr[] = { { "stage 1: volume rendering", x, y[PSNR], first }, { "stage 2: relighting", x + first, y[PSNR] + first, second } };
    orl_plot_svg(&p->body, psnr, 2, &(orl_plot_style){ .title = "PSNR on training pixels", .x_label = "CPU minutes", .y_label = "dB", .w = 560, .h = 320 });
    const orl_plot_series one[] = { { "photometric (MSE)", x, y[MSE], first }, { "sky mask", x, y[SKY], first }, { "Eikonal", x, y[EIKONAL], first }, { "points, cells", x, y[POINTS], first }, { "transient share", x, y[TRANSIENT], first } };
    if (first > 1) orl_plot_svg(&p->body, one, 5, &(orl_plot_style){ .title = "Stage 1: losses", .x_label = "CPU minutes", .log_y = 1, .w = 560, .h = 320 });
    const orl_plot_series two[] = { { "photometric (MSE)", x + first, y[MSE] + first, second }, { "light of photos (residual, rms)", x + first, y[CODES] + first, second } };
    if (second > 1) orl_plot_svg(&p->body, two, 2, &(orl_plot_style){ .title = "Stage 2: losses", .x_label = "CPU minutes", .log_y = 1, .key_above = 1, .w = 560, .h = 320 });
    orl_text_add(&p->body, "</div>\n");
}

/* ---- ablation ---- */

/* What a variant does without. */
static const char *meaning(const char *variant)
{
    static const struct { const char *variant, *what; } KNOWN[] = {
        { "full", "everything" }, { "light paper", "nothing hides sun or sky, and the ground throws nothing back" }, { "without tone", "no tone matrix" }, { "without shadow", "no learned shadow" },
        { "without visibility", "nothing hides sun or sky" }, { "without ground", "no light from the ground" }, { "without distill", "the photos' own pixels, people and all" }, { "without sky-prior", "no prior of sun and sky" } };
    for (size_t i = 0; i < sizeof KNOWN / sizeof *KNOWN; i++) if (!strcmp(variant, KNOWN[i].variant)) return KNOWN[i].what;
    return "";
}

static const struct { const char *title; int digits, db; } FIGURE[ABLATION_FIGURES] = {
    [ABLATION_PSNR] = { "PSNR, dB", 2, 0 }, [ABLATION_SSIM] = { "SSIM", 3, 0 }, [ABLATION_FLIP] = { "FLIP", 3, 0 }, [ABLATION_FULL] = { "whole photo, dB", 2, 1 }, [ABLATION_ALBEDO] = { "base colour, dB", 2, 1 },
    [ABLATION_SUN] = { "sun off by", 1, 0 }, [ABLATION_RELIT] = { "other skies, dB", 2, 1 } };

/* The difference to `full` in dB, and as a bar: to the left what is worse. */
static void add_bar(orl_text *t, double d, double widest)
{
    orl_text_add(t, "<td>%+.2f</td><td class=\"bar\"><i class=\"%s\" style=\"width:%.1f%%\"></i></td>", fabs(d) < 0.005 ? 0.0 : d, d < 0 ? "worse" : "better", 50 * fabs(d) / widest);
}

static void add_cells(orl_text *t, const ablation *a, const ablation_row *r, const int *any, double widest)
{
    const ablation_row *full = &a->row[a->full];
    for (int k = 0; k < ABLATION_FIGURES; k++) {
        if (!any[k]) continue;
        if (isfinite(r->v[k])) orl_text_add(t, "<td>%.*f%s", FIGURE[k].digits, r->v[k], k == ABLATION_SUN ? "&deg;" : "");
        else orl_text_add(t, "<td>&ndash;");
        if (FIGURE[k].db && r != full && isfinite(r->v[k] - full->v[k])) orl_text_add(t, " <small>%+.2f</small>", r->v[k] - full->v[k]);
        orl_text_add(t, "</td>");
        if (k != ABLATION_PSNR) continue;
        if (r == full) orl_text_add(t, "<td></td><td class=\"bar\"></td>");
        else add_bar(t, r->v[k] - full->v[k], widest);
    }
}

void report_add_ablation(page *p)
{
    const ablation *a = p->parts;
    orl_text *t = &p->body;
    int any[ABLATION_FIGURES] = { 0 };
    double widest = 1e-9;
    if (!a) return;
    for (int i = 0; i < a->n; i++) {
        widest = fmax(widest, fabs(a->row[i].v[ABLATION_PSNR] - a->row[a->full].v[ABLATION_PSNR]));
        for (int k = 0; k < ABLATION_FIGURES; k++) any[k] |= isfinite(a->row[i].v[k]) != 0;
    }
    report_section(p, "ablation", "Ablation");
    orl_text_add(t, "<p>Stage 2 from the same geometry, each time without one of its parts. Scores of the right half of test photos, fixed point; small figures: difference to <b>full</b>.</p>\n"
                "<div class=\"scroll\">\n<table class=\"ablation\">\n<tr><th>variant</th>");
    for (int k = 0; k < ABLATION_FIGURES; k++) if (any[k]) orl_text_add(t, "<th>%s</th>%s", FIGURE[k].title, k == ABLATION_PSNR ? "<th colspan=\"2\">against full, dB</th>" : "");
    orl_text_add(t, "</tr>\n");
    for (int i = 0; i < a->n; i++) {
        orl_text_add(t, "<tr%s><td><b>", i == a->full ? " class=\"ours\"" : "");
        orl_text_escape(t, a->row[i].variant);
        orl_text_add(t, "</b> <small>%s</small></td>", meaning(a->row[i].variant));
        add_cells(t, a, &a->row[i], any, widest);
        orl_text_add(t, "</tr>\n");
    }
    orl_text_add(t, "</table>\n</div>\n");
}
