/* OpenEXR through its C core API: scan lines, linear float in memory, half or float in files. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/image.h"
#ifdef ORL_HAVE_EXR
#include <openexr.h>

static void quiet(exr_const_context_t c, exr_result_t code, const char *msg) { (void)c; (void)code; (void)msg; }

/* Index of a channel by name among comma-separated names, or by letter where names has no comma. */
static int wanted(const char *names, const char *channel)
{
    if (!strchr(names, ',')) {
        const char *p = strlen(channel) == 1 ? strchr(names, channel[0]) : NULL;
        return p ? (int)(p - names) : -1;
    }
    size_t n = strlen(channel);
    int k = 0;
    for (const char *p = names; p; k++) {
        if (!strncmp(p, channel, n) && (p[n] == ',' || !p[n])) return k;
        p = strchr(p, ',');
        if (p) p++;
    }
    return -1;
}

static int name_count(const char *names)
{
    if (!strchr(names, ',')) return (int)strlen(names);
    int n = 1;
    for (; *names; names++) n += *names == ',';
    return n;
}

static float from_half(uint32_t h)
{
    uint32_t sign = (h & 0x8000) << 16, e = h >> 10 & 31, m = h & 1023, b = sign | (e == 31 ? 255 : e + 112) << 23 | m << 13;
    float v;
    if (!e) return sign ? -(float)m * 0x1p-24f : (float)m * 0x1p-24f;
    memcpy(&v, &b, 4);
    return v;
}

/* One chunk's bytes (lines; in each the channels one after another) to the channels wanted, whose first pixel is at out. The library's own unpacking is passed by: 3.1 writes
 * through null pointers where a channel is not wanted, and turns RGBA round. */
static int unpack(const exr_decode_pipeline_t *d, const char *names, int c, int w, float *out)
{
    const uint8_t *p = d->unpacked_buffer, *end = p + d->chunk.unpacked_size;
    for (int y = 0; y < d->chunk.height; y++, out += (size_t)w * (size_t)c)
        for (int k = 0; k < d->channel_count; k++) {
            const exr_coding_channel_info_t *ch = &d->channels[k];
            int at = wanted(names, ch->channel_name);
            int64_t size = (int64_t)ch->width * ch->bytes_per_element;
            if (ch->y_samples > 1 && (d->chunk.start_y + y) % ch->y_samples) continue;
            if (size > end - p) return 0;
            for (int x = 0; at >= 0 && x < w; x++) {
                uint16_t h;
                uint32_t u;
                float *o = out + (size_t)x * (size_t)c + at;
                if (ch->data_type == EXR_PIXEL_HALF) { memcpy(&h, p + 2 * (size_t)x, 2); *o = from_half(h); }
                else if (ch->data_type == EXR_PIXEL_FLOAT) memcpy(o, p + 4 * (size_t)x, 4);
                else { memcpy(&u, p + 4 * (size_t)x, 4); *o = (float)u; }
            }
            p += size;
        }
    return 1;
}

orl_err orl_exr_read(const char *path, const char *names, orl_imagef *out)
{
    exr_context_t f = NULL;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_attr_box2i_t win;
    exr_storage_t kind;
    int32_t lines = 1;
    orl_imagef o = { 0 };
    init.error_handler_fn = quiet;
    exr_result_t opened = exr_start_read(&f, path, &init);
    if (opened == EXR_ERR_FILE_ACCESS) return orl_fail(ORL_E_IO, "%s: cannot be opened", path);
    if (opened) return orl_fail(ORL_E_FORMAT, "%s: not an OpenEXR file that can be read", path);
    orl_err e = ORL_OK;
    int c = name_count(names), have = 0;
    if (exr_get_storage(f, 0, &kind) || kind != EXR_STORAGE_SCANLINE) e = orl_fail(ORL_E_UNSUPPORTED, "%s: only scan-line files are read", path);
    else if (exr_get_data_window(f, 0, &win) || exr_get_scanlines_per_chunk(f, 0, &lines) || lines < 1) e = orl_fail(ORL_E_FORMAT, "%s: data window", path);
    else {
        int64_t w = (int64_t)win.max.x - win.min.x + 1, h = (int64_t)win.max.y - win.min.y + 1;
        if (w < 1 || h < 1 || w > ORL_IMAGE_MAX_SIDE || h > ORL_IMAGE_MAX_SIDE) e = orl_fail(ORL_E_RANGE, "%s: data window %lld x %lld", path, (long long)w, (long long)h);
        else e = orl_imagef_alloc(&o, (int)w, (int)h, c);
    }
    exr_decode_pipeline_t d = EXR_DECODE_PIPELINE_INITIALIZER;
    int ready = 0;
    for (int y = 0; !e && y < o.h; y += lines) {
        exr_chunk_info_t chunk;
        int bad = exr_read_scanline_chunk_info(f, 0, win.min.y + y, &chunk) != EXR_ERR_SUCCESS;
        bad = bad || (ready ? exr_decoding_update(f, 0, &chunk, &d) : exr_decoding_initialize(f, 0, &chunk, &d)) != EXR_ERR_SUCCESS;
        have = 0;
        for (int k = 0; !bad && k < d.channel_count; k++) {
            exr_coding_channel_info_t *ch = &d.channels[k];
            ch->decode_to_ptr = NULL;
            if (wanted(names, ch->channel_name) < 0) continue;
            if (ch->x_samples != 1 || ch->y_samples != 1 || ch->width != o.w) have = -c;    /* thinned out: not what was asked for */
            have++;
        }
        if (!bad && have != c) e = orl_fail(ORL_E_FORMAT, "%s: channels %s are not all there", path, names);
        if (!bad && !e && !ready) bad = exr_decoding_choose_default_routines(f, 0, &d) != EXR_ERR_SUCCESS;
        ready = 1;
        d.unpack_and_convert_fn = NULL;
        if (!e && (bad || exr_decoding_run(f, 0, &d) != EXR_ERR_SUCCESS || !unpack(&d, names, c, o.w, o.px + (size_t)y * (size_t)o.w * (size_t)c))) e = orl_fail(ORL_E_FORMAT, "%s: line %d does not decode", path, y);
    }
    if (ready) exr_decoding_destroy(f, &d);
    exr_finish(&f);
    if (e) { orl_imagef_free(&o); return e; }
    for (size_t i = 0, n = (size_t)o.w * (size_t)o.h * (size_t)c; i < n; i++) if (!isfinite(o.px[i])) o.px[i] = o.px[i] > 0 ? 65504.0f : 0.0f;
    *out = o;
    return ORL_OK;
}

typedef struct { char name[64]; int at; } channel;
static int by_channel(const void *a, const void *b) { return strcmp(((const channel *)a)->name, ((const channel *)b)->name); }

static orl_err write_as(const char *path, const orl_imagef *im, const char *names, exr_pixel_type_t type)
{
    char tmp[4200];
    channel ch[ORL_IMAGEF_MAX_CHANNELS];
    int c = 0, more = 1;
    for (const char *p = names; more && c < ORL_IMAGEF_MAX_CHANNELS; c++) {
        size_t n = strcspn(p, ",");
        if (n == 0 || n >= sizeof ch[c].name) return orl_fail(ORL_E_RANGE, "%s: channel names %s", path, names);
        memcpy(ch[c].name, p, n);
        ch[c].name[n] = 0;
        ch[c].at = c;
        p += n;
        more = *p++ == ',';
    }
    if (more || c != im->c) return orl_fail(ORL_E_RANGE, "%s: %d%s channel names for %d channels", path, c, more ? " and more" : "", im->c);
    qsort(ch, (size_t)c, sizeof *ch, by_channel);   /* files list channels by name */
    if (snprintf(tmp, sizeof tmp, "%s.tmp%ld", path, (long)getpid()) >= (int)sizeof tmp) return orl_fail(ORL_E_RANGE, "%s: path is too long", path);
    exr_context_t f = NULL;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = quiet;
    int part = 0, bad = exr_start_write(&f, tmp, EXR_WRITE_FILE_DIRECTLY, &init) != EXR_ERR_SUCCESS;
    if (bad) return orl_fail(ORL_E_IO, "%s: cannot be written", path);
    bad = exr_add_part(f, "rgb", EXR_STORAGE_SCANLINE, &part) != EXR_ERR_SUCCESS || exr_initialize_required_attr_simple(f, part, im->w, im->h, EXR_COMPRESSION_ZIP) != EXR_ERR_SUCCESS;
    for (int k = 0; !bad && k < c; k++) bad = exr_add_channel(f, part, ch[k].name, type, EXR_PERCEPTUALLY_LINEAR, 1, 1) != EXR_ERR_SUCCESS;
    int32_t lines = 1;
    bad = bad || exr_write_header(f) != EXR_ERR_SUCCESS || exr_get_scanlines_per_chunk(f, part, &lines) != EXR_ERR_SUCCESS;
    exr_encode_pipeline_t e = EXR_ENCODE_PIPELINE_INITIALIZER;
    int ready = 0;
    for (int y = 0; !bad && y < im->h; y += lines) {
        exr_chunk_info_t chunk;
        bad = exr_write_scanline_chunk_info(f, part, y, &chunk) != EXR_ERR_SUCCESS;
        bad = bad || (ready ? exr_encoding_update(f, part, &chunk, &e) : exr_encoding_initialize(f, part, &chunk, &e)) != EXR_ERR_SUCCESS;
        for (int k = 0; !bad && k < e.channel_count; k++) {
            e.channels[k].encode_from_ptr = (const uint8_t *)(im->px + (size_t)y * (size_t)im->w * (size_t)c + (size_t)ch[k].at);
            e.channels[k].user_pixel_stride = 4 * c;
            e.channels[k].user_line_stride = 4 * c * im->w;
            e.channels[k].user_bytes_per_element = 4;
            e.channels[k].user_data_type = EXR_PIXEL_FLOAT;
        }
        if (!bad && !ready) bad = exr_encoding_choose_default_routines(f, part, &e) != EXR_ERR_SUCCESS;
        ready = 1;
        bad = bad || exr_encoding_run(f, part, &e) != EXR_ERR_SUCCESS;
    }
    if (ready) exr_encoding_destroy(f, &e);
    bad = exr_finish(&f) != EXR_ERR_SUCCESS || bad;
    if (!bad) return orl_file_replace(tmp, path);
    unlink(tmp);
    return orl_fail(ORL_E_IO, "%s: cannot be written", path);
}

orl_err orl_exr_write(const char *path, const orl_imagef *im, const char *names) { return write_as(path, im, names, EXR_PIXEL_HALF); }
orl_err orl_exr_write_float(const char *path, const orl_imagef *im, const char *names) { return write_as(path, im, names, EXR_PIXEL_FLOAT); }
#else
orl_err orl_exr_read(const char *path, const char *names, orl_imagef *out)
{
    (void)names; (void)out;
    return orl_fail(ORL_E_UNSUPPORTED, "%s: this build has no OpenEXR", path);
}
orl_err orl_exr_write(const char *path, const orl_imagef *im, const char *names)
{
    (void)im; (void)names;
    return orl_fail(ORL_E_UNSUPPORTED, "%s: this build has no OpenEXR", path);
}
orl_err orl_exr_write_float(const char *path, const orl_imagef *im, const char *names) { return orl_exr_write(path, im, names); }
#endif
