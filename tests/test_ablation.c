/* The ablation table's reader: what it takes, and that it refuses everything else by file and line. */
#include "tests/scratch.h"
#include <math.h>
#include "trainer/ablation.h"

#define HEADING "variant\tpsnr\tssim\tflip\tpsnr_full\talbedo_psnr\tsun_median_deg\trelit_psnr\n"
static const char GOOD[] = HEADING "without tone\t18.1\t.63\t3.3e-1\t18.7\t-\t-\t-\nfull\t18.37\t0.64\t0.322\t18.92\t17.5\t11.5\t-1.5\n";

static void good(void **state)
{
    (void)state;
    ablation t;
    put_text(at("a.tsv"), GOOD);
    ok(ablation_read(at("a.tsv"), &t));
    assert_int_equal(t.n, 2);
    assert_int_equal(t.full, 1);
    assert_string_equal(t.row[0].variant, "without tone");
    assert_true(t.row[0].v[ABLATION_PSNR] == 18.1 && t.row[0].v[ABLATION_FLIP] == 0.33 && isnan(t.row[0].v[ABLATION_ALBEDO]) && t.row[1].v[ABLATION_RELIT] == -1.5);
    put_text(at("crlf.tsv"), "variant\tpsnr\tssim\tflip\tpsnr_full\talbedo_psnr\tsun_median_deg\trelit_psnr\r\nfull\t1\t1\t1\t1\t1\t1\t-\r\n");
    ok(ablation_read(at("crlf.tsv"), &t));
    assert_true(t.n == 1 && isnan(t.row[0].v[ABLATION_RELIT]));
}

static void refused(void **state)
{
    (void)state;
    static const struct { const char *text, *line, *why; } BAD[] = {
        { "", "line 1:", "heading" }, { "[{\"variant\": \"full\"}]", "line 1:", "heading" }, { "variant\tpsnr\n", "line 1:", "heading" }, { HEADING, "line 1:", "full" },
        { HEADING "without tone\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "full" }, { HEADING "full\t1\t1\t1\t1\t1\t1\n", "line 2:", "columns" }, { HEADING "full\t1\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "columns" },
        { HEADING "full\t-\t1\t1\t1\t1\t1\t1\n", "line 2:", "column 2" }, { HEADING "full\t1\t\t1\t1\t1\t1\t1\n", "line 2:", "column 3" }, { HEADING "full\t1\t1\tnan\t1\t1\t1\t1\n", "line 2:", "column 4" },
        { HEADING "full\t1\t1\t1\tinf\t1\t1\t1\n", "line 2:", "column 5" }, { HEADING "full\t1\t1\t1\t1\t1e999\t1\t1\n", "line 2:", "column 6" }, { HEADING "full\t1\t1\t1\t1\t1\t1001\t1\n", "line 2:", "column 7" },
        { HEADING "full\t1\t1\t1\t1\t1\t1\t1 dB\n", "line 2:", "column 8" }, { HEADING "full\t1\t1\t1\t1\t1\t1\t1\n\n", "line 3:", "name" }, { HEADING "full\t1\t1\t1\t1\t1\t1\t1\nfull\t1\t1\t1\t1\t1\t1\t1\n", "line 3:", "second" },
        { HEADING "\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "name" }, { HEADING "f\x1b[2Jull\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "name" }, { HEADING "f\xc3\xbcll\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "name" },
        { HEADING "0123456789012345678901234567890123456789012345678901234567890123\t1\t1\t1\t1\t1\t1\t1\n", "line 2:", "name" } };
    ablation t;
    memset(&t, 7, sizeof t);
    for (size_t i = 0; i < sizeof BAD / sizeof *BAD; i++) {
        put_text(at("bad.tsv"), BAD[i].text);
        failed(ablation_read(at("bad.tsv"), &t), ORL_E_FORMAT, "bad.tsv: ", BAD[i].line, BAD[i].why, NULL);
    }
    put_bytes(at("bad.tsv"), HEADING "full\t1\0", sizeof HEADING + 6);
    failed(ablation_read(at("bad.tsv"), &t), ORL_E_FORMAT, "bad.tsv: line 2: a zero byte", NULL);
    for (size_t i = 0; i < sizeof t; i++) assert_int_equal(((const unsigned char *)&t)[i], 7);
}

static void too_much(void **state)
{
    (void)state;
    ablation t;
    static char big[1 << 17];
    size_t n = (size_t)sprintf(big, HEADING "full\t1\t1\t1\t1\t1\t1\t1\n");
    for (int i = 1; i < ABLATION_ROWS; i++) n += (size_t)sprintf(big + n, "v%d\t1\t1\t1\t1\t1\t1\t1\n", i);
    put_bytes(at("most.tsv"), big, n);
    ok(ablation_read(at("most.tsv"), &t));
    assert_int_equal(t.n, ABLATION_ROWS);
    n += (size_t)sprintf(big + n, "one more\t1\t1\t1\t1\t1\t1\t1\n");
    put_bytes(at("more.tsv"), big, n);
    failed(ablation_read(at("more.tsv"), &t), ORL_E_RANGE, "more.tsv: line 66: ", "64 variants", NULL);
    memset(big, 'x', sizeof big);
    put_bytes(at("huge.tsv"), big, sizeof big);
    failed(ablation_read(at("huge.tsv"), &t), ORL_E_RANGE, "huge.tsv", NULL);
    failed(ablation_read(at("nowhere.tsv"), &t), ORL_E_IO, "nowhere.tsv", NULL);
}

/* Every length and any byte: a table whose figures are finite or left out, or one line that says where. */
static void mangled(void **state)
{
    (void)state;
    seed_print();
    for (size_t k = 0; k < 3000; k++) {
        char text[sizeof GOOD];
        size_t n = k < sizeof GOOD ? k : sizeof GOOD - 1;
        ablation t;
        memcpy(text, GOOD, sizeof GOOD);
        for (int i = 0; k >= sizeof GOOD && i < 3; i++) text[rnd() % n] = "\t\n\r-0e.\x01\xff\0f"[rnd() % 11];
        put_bytes(at("m.tsv"), text, n);
        orl_err e = ablation_read(at("m.tsv"), &t);
        if (e) {
            failed(e, ORL_E_FORMAT, "m.tsv: line ", NULL);
        } else {
            assert_true(t.n >= 1 && t.full >= 0 && t.full < t.n && !strcmp(t.row[t.full].variant, "full"));
            for (int i = 0; i < t.n; i++) for (int f = 0; f < ABLATION_FIGURES; f++) assert_true(isfinite(t.row[i].v[f]) || (f && isnan(t.row[i].v[f])));
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(good), cmocka_unit_test(refused), cmocka_unit_test(too_much), cmocka_unit_test(mangled) };
    return cmocka_run_group_tests(tests, scratch_make, scratch_remove);
}
