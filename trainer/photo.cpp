// OpenImageIO behind a C interface: the only C++ of the trainer. Nothing throws past this file.
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <cmath>
extern "C" {
#include "oriel/dataset.h"
orl_err photo_decode(const char *path, int channels, orl_image *out, int *turned);
}

// Grey is spread over RGB, alpha is dropped.
static OIIO::ImageBuf with_channels(const OIIO::ImageBuf &in, int channels)
{
    int order[3] = { 0, in.nchannels() >= 3 ? 1 : 0, in.nchannels() >= 3 ? 2 : 0 };
    return OIIO::ImageBufAlgo::channels(in, channels, OIIO::cspan<int>(order, channels));
}

// By EXIF's orientation, 2 to 8. OpenImageIO 2.4 takes 5 and 7 for each other.
static OIIO::ImageBuf upright(const OIIO::ImageBuf &in, int orientation)
{
    if (orientation != 5 && orientation != 7) return OIIO::ImageBufAlgo::reorient(in);
    OIIO::ImageBuf t = OIIO::ImageBufAlgo::transpose(in);
    return orientation == 5 ? t : OIIO::ImageBufAlgo::rotate180(t);
}

// Whether a JPEG's scans reach the end mark: OpenImageIO fills one that is cut short with grey and says nothing. Other files pass.
static bool is_whole(const char *path)
{
    uint8_t *b;
    size_t n, i = 2;
    if (orl_file_read(path, (size_t)1 << 30, &b, &n)) return false;
    bool jpeg = n >= 3 && b[0] == 0xff && b[1] == 0xd8 && b[2] == 0xff, end = false;
    while (jpeg && !end && i + 4 <= n + 2) {
        int m = b[i] == 0xff && i + 1 < n ? b[i + 1] : 0;
        if (m == 0xd9) end = true;
        else if (m == 0 || m == 0xff) i++;                         // coded bytes, fill
        else if (m == 1 || (m >= 0xd0 && m <= 0xd8)) i += 2;       // marks without a length
        else i += i + 4 <= n ? 2 + (b[i + 2] << 8 | b[i + 3]) : n;
    }
    free(b);
    return !jpeg || end;
}

static bool open_image(const char *path, int channels, OIIO::TypeDesc type, OIIO::ImageBuf &out, int *turned, orl_err *err)
{
    OIIO::ImageBuf file(path);
    if (!file.read(0, 0, true, type)) {
        std::string why = file.geterror();
        size_t nl = why.find('\n');
        if (nl != std::string::npos) why.resize(nl);
        *err = orl_fail(ORL_E_FORMAT, "%s: does not decode: %s", path, why.c_str());
        return false;
    }
    if (!is_whole(path)) { *err = orl_fail(ORL_E_FORMAT, "%s: does not decode: cut short", path); return false; }
    int orientation = file.orientation();
    if (turned) *turned = orientation >= 5 && orientation <= 8;
    out = with_channels(orientation > 1 ? upright(file, orientation) : file, channels);
    if (out.has_error()) { *err = orl_fail(ORL_E_FORMAT, "%s: cannot be converted", path); return false; }
    return true;
}

extern "C" orl_err photo_decode(const char *path, int channels, orl_image *out, int *turned)
try {
    OIIO::ImageBuf im;
    orl_image o;
    orl_err e = ORL_OK;
    if (!open_image(path, channels, OIIO::TypeDesc::UINT8, im, turned, &e)) return e;
    OIIO::ROI roi = im.roi();
    if ((e = orl_image_alloc(&o, roi.width(), roi.height(), channels))) return e;
    if (!im.get_pixels(OIIO::ROI(roi.xbegin, roi.xend, roi.ybegin, roi.yend, 0, 1, 0, channels), OIIO::TypeDesc::UINT8, o.px)) {
        orl_image_free(&o);
        return orl_fail(ORL_E_FORMAT, "%s: pixels cannot be read", path);
    }
    *out = o;
    return ORL_OK;
} catch (const std::exception &x) {
    return orl_fail(ORL_E_FORMAT, "%s: %s", path, x.what());
}

extern "C" orl_err orl_oiio_read_float(const char *path, orl_imagef *out)
try {
    OIIO::ImageBuf im;
    orl_imagef o;
    orl_err e = ORL_OK;
    if (!open_image(path, 3, OIIO::TypeDesc::FLOAT, im, nullptr, &e)) return e;
    OIIO::ROI roi = im.roi();
    if ((e = orl_imagef_alloc(&o, roi.width(), roi.height(), 3))) return e;
    if (!im.get_pixels(OIIO::ROI(roi.xbegin, roi.xend, roi.ybegin, roi.yend, 0, 1, 0, 3), OIIO::TypeDesc::FLOAT, o.px)) {
        orl_imagef_free(&o);
        return orl_fail(ORL_E_FORMAT, "%s: pixels cannot be read", path);
    }
    for (size_t i = 0, n = (size_t)o.w * o.h * 3; i < n; i++) if (!std::isfinite(o.px[i])) o.px[i] = o.px[i] > 0 ? 65504.0f : 0.0f;
    *out = o;
    return ORL_OK;
} catch (const std::exception &x) {
    return orl_fail(ORL_E_FORMAT, "%s: %s", path, x.what());
}
