/* Instructions of PTX that C does not have, for what translate.py writes. */
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <xmmintrin.h>

#define INLINE static inline __attribute__((always_inline))

/* registers are integers of their size */
INLINE float as_f32(uint32_t x) { float y; memcpy(&y, &x, 4); return y; }
INLINE double as_f64(uint64_t x) { double y; memcpy(&y, &x, 8); return y; }
INLINE uint32_t of_f32(float x) { uint32_t y; memcpy(&y, &x, 4); return y; }
INLINE uint64_t of_f64(double x) { uint64_t y; memcpy(&y, &x, 8); return y; }
#define LOAD(type, address) ({ type x_; memcpy(&x_, (const void *) (uintptr_t) (address), sizeof x_); x_; })
#define STORE(type, address, value) do { \
    type x_ = (type) (value); memcpy((void *) (uintptr_t) (address), &x_, sizeof x_); } while (0)

/* What `.approx` leaves open. With ROUGH results are off by as many roundings as the manual allows,
 * up or down by the last bits of the exact one; without it they are the nearest numbers. */
INLINE float near_to(double exact, int roundings) {
    float x = (float) exact;
#ifdef ROUGH
    uint32_t bits = of_f32(x);
    if (x == x && !isinf(x) && x != 0) x = as_f32(bits + ((bits >> 3) & 1 ? roundings : -roundings));
#endif
    return x;
}
/* 20 bits of the mantissa come in, and 20 go out */
INLINE double reciprocal_approx_f64(double x) {
    if (x != x) return NAN;
    x = as_f64(of_f64(x) & 0xffffffff00000000ull);
    if (fabs(x) < 2.2250738585072014e-308) return copysign(INFINITY, x);
    double y = 1.0 / x;
    if (fabs(y) < 2.2250738585072014e-308) return copysign(0.0, y);
    return as_f64(of_f64(y) & 0xffffffff00000000ull);
}
INLINE float divide_approx_f32(float a, float b) {
    if (fabsf(b) > 0x1p126f && !isinf(b))
        return isinf(a) || a != a ? NAN : copysignf(0.f, a) * copysignf(1.f, b);
    return near_to((double) a / b, 2);
}

/* minima and maxima: of a NaN and a number the number, with `.NaN` the NaN */
#define MINMAX(name, type, better) \
    INLINE type name##_num(type a, type b) { \
        return a != a ? b : b != b ? a : a better b ? a : b better a ? b : signbit(a) == (1 better 2) ? a : b; } \
    INLINE type name##_nan(type a, type b) { return a != a || b != b ? NAN : name##_num(a, b); }
MINMAX(min_f32, float, <)
MINMAX(max_f32, float, >)
MINMAX(min_f64, double, <)
MINMAX(max_f64, double, >)

/* conversions to integers: NaN is zero, what is too large the largest */
INLINE uint32_t to_u32(double x) { return !(x > 0) ? 0 : x >= 0x1p32 ? ~0u : (uint32_t) x; }
INLINE uint32_t to_s32(double x) {
    return x != x ? 0 : x <= -0x1p31 ? 0x80000000u : x >= 0x1p31 ? 0x7fffffffu
                                                                 : (uint32_t) (int32_t) x;
}

/* shifts by as many bits as there are, or more */
#define SHIFT_LEFT(x, n, bits) ((n) >= (bits) ? 0 : (x) << (n))
#define SHIFT_RIGHT(x, n, bits) ((n) >= (bits) ? 0 : (x) >> (n))
#define SHIFT_SIGNED(x, n, bits) ((x) >> ((n) >= (bits) ? (bits) - 1 : (n)))
INLINE uint32_t leading_32(uint32_t x) { return x ? __builtin_clz(x) : 32; }
INLINE uint32_t leading_64(uint64_t x) { return x ? __builtin_clzll(x) : 64; }
INLINE uint32_t turned_32(uint32_t x) {
    x = __builtin_bswap32(x);
    x = (x >> 4 & 0x0f0f0f0f) | (x & 0x0f0f0f0f) << 4;
    x = (x >> 2 & 0x33333333) | (x & 0x33333333) << 2;
    return (x >> 1 & 0x55555555) | (x & 0x55555555) << 1;
}
INLINE uint64_t turned_64(uint64_t x) {
    return (uint64_t) turned_32(x) << 32 | turned_32(x >> 32);
}
