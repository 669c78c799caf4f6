/* Plots: ticks, what is drawn and what is left out, names that markup must not see. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/plot.h"

static void ticks(void **state)
{
    (void)state;
    const struct { double lo, hi, step, first; } want[] = { { 0, 10, 2, 0 }, { 12.3, 17.9, 1, 12 }, { -0.03, 0.04, 0.02, -0.04 }, { 990, 1010, 5, 990 } };
    for (int i = 0; i < 4; i++) {
        double first, step = orl_plot_ticks(want[i].lo, want[i].hi, 6, &first);
        assert_true(fabs(step - want[i].step) < 1e-9 * want[i].step && fabs(first - want[i].first) < 1e-9 * (1 + fabs(first)));
    }
}

static int count(const char *s, const char *what)
{
    int n = 0;
    for (; (s = strstr(s, what)); s++) n++;
    return n;
}

static void drawing(void **state)
{
    (void)state;
    const double x[] = { 0, 1, 10, NAN, 100 }, y[] = { 1, 2, 4, 3, 8 }, flat[] = { 5, 5, 5, 5, INFINITY };
    const orl_plot_series two[] = { { "a < \"b\" & c", x, y, 5 }, { "flat", x, flat, 5 } };
    orl_text t = { 0 };
    orl_plot_svg(&t, two, 2, &(orl_plot_style){ .title = "<it>", .x_label = "x & y", .log_x = 1, .dots = 1, .w = 400, .h = 300 });
    assert_false(t.failed);
    assert_int_equal(count(t.s, "<circle"), 3 + 2);         /* x = 0 has no logarithm; NaN and infinity are no points */
    assert_null(strstr(t.s, "nan"));
    assert_null(strstr(t.s, "inf"));
    assert_non_null(strstr(t.s, "a &lt; &quot;b&quot; &amp; c"));
    assert_non_null(strstr(t.s, "&lt;it&gt;"));
    for (int d = 1; d <= 100; d *= 10) {
        char tick[40];
        snprintf(tick, sizeof tick, ">%d</text>", d);
        assert_non_null(strstr(t.s, tick));
    }
    orl_text_free(&t);
    const double small[] = { 0, 0.002, 0.3, -1, 0.05 };
    const orl_plot_series fall[] = { { "a", x, small, 5 }, { "b", x, small, 0 }, { "c", x, small, 0 }, { "d", x, small, 0 }, { "e", x, small, 0 } };
    orl_plot_svg(&t, fall, 5, &(orl_plot_style){ .log_y = 1, .dots = 1, .key_above = 1, .w = 400, .h = 300 });
    assert_int_equal(count(t.s, "<circle"), 3);             /* 0 and -1 have no logarithm */
    for (int d = 1; d <= 1000; d *= 10) {
        char tick[40];
        snprintf(tick, sizeof tick, ">%.6g</text>", 1.0 / d);
        assert_int_equal(count(t.s, tick), 1);
    }
    assert_null(strstr(t.s, ">0.5</text>"));                /* three decades: powers of ten alone */
    assert_null(strstr(t.s, "nan"));
    orl_text_free(&t);
    const orl_plot_series one = { "", x, y, 1 }, none = { "", x, y, 0 };
    orl_plot_svg(&t, &one, 1, &(orl_plot_style){ .w = 400, .h = 300 });
    orl_plot_svg(&t, &none, 1, &(orl_plot_style){ .w = 400, .h = 300, .log_x = 1, .log_y = 1 });
    assert_null(strstr(t.s, "nan"));
    assert_null(strstr(t.s, "inf"));
    orl_text_free(&t);
    const char *const label[] = { "one & only", "two", NULL, "no point", "" }, *const *const labels[] = { label };
    const orl_plot_series marks = { "marks", x, y, 5 };
    orl_plot_svg(&t, &marks, 1, &(orl_plot_style){ .dots = 1, .no_lines = 1, .labels = labels, .w = 400, .h = 300 });
    assert_null(strstr(t.s, "stroke-linejoin"));            /* no line, */
    assert_int_equal(count(t.s, "<circle"), 4);             /* all points but NaN, */
    assert_int_equal(count(t.s, "textLength"), 2);          /* and the labels of those that have one */
    assert_non_null(strstr(t.s, ">one &amp; only</text>"));
    assert_null(strstr(t.s, "no point"));
    orl_text_free(&t);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(ticks), cmocka_unit_test(drawing) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
