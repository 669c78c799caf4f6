/* Tiles of ROWS samples through all layers of an int8 network, for both sets of ARM kernels. A file says before it includes this how many ROWS, what 8 outputs of them are, eight(), and what the function is called, RUN. */
static void RUN(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    const int in = m->layer[0].in, end = m->layers - 1, out = m->layer[end].out;
    int8_t a[2][ROWS * ORL_MLP_WIDTH];
    for (int s = 0; s < n; s += ROWS, y += ROWS * out) {
        for (int r = 0; r < ROWS; r++, x += in)
            for (int i = 0; i < in; i += 16) vst1q_s8(a[0] + i * ROWS + 16 * r, vld1q_s8(x + i));
        for (int k = 0; k < end; k++)
            for (int o = 0; o < m->layer[k].out; o += 8) eight(m, k, o, a[k & 1], a[~k & 1] + o / 16 * 16 * ROWS + o % 16, 16, 0);
        for (int o = 0; o < out; o += 8) eight(m, end, o, a[end & 1], y + o, out, 1);
    }
}
