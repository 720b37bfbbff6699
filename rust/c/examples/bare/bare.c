/* A program without operating system's or C's library around sherkit: nothing but this file and the static library.
 *
 *   make -C rust/c/examples/bare run
 *
 * It steps the tool's filter and the delta a thousand times and tells by its exit code whether all went well. On Linux
 * the first and the last instruction are the only ones that know of it; on a microcontroller they are the reset
 * handler and an endless loop, and the library is built for its target:
 *
 *   cargo build --profile control -p sherkit-c --target thumbv7em-none-eabihf */

#include "../robots.h"
#include "sherkit.h"

/* What a compiler may call without being asked. */
void *memcpy(void *restrict to, const void *restrict from, size_t count)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    while (count--)
        *t++ = *f++;
    return to;
}

void *memmove(void *to, const void *from, size_t count)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    if (t < f)
        return memcpy(to, from, count);
    while (count--)
        t[count] = f[count];
    return to;
}

void *memset(void *to, int value, size_t count)
{
    unsigned char *t = to;
    while (count--)
        *t++ = (unsigned char)value;
    return to;
}

int memcmp(const void *a, const void *b, size_t count)
{
    const unsigned char *x = a, *y = b;
    for (; count--; x++, y++)
        if (*x != *y)
            return *x - *y;
    return 0;
}

/* State of the loop: known when the program is linked. */
static sherkit_delta robot;
static sherkit_sensor sensor;
static sherkit_tool_filter filter;
static sherkit_tool tool;

static const sherkit_sensor_calibration calibration = {
    {{{8e3, -4e3, -4e3}, {0.0, 6.9e3, -6.9e3}}, {{8e3, -4e3, -4e3}, {0.0, 6.9e3, -6.9e3}}},
    {28.0, 34.0},
    {{1550.0, 1550.0, 1550.0}, {1550.0, 1550.0, 1550.0}, {1550.0, 1550.0, 1550.0}},
    2e-4};

/* 0, or what went wrong. */
static int run(void)
{
    const sherkit_beam beam = sherkit_beam_ebrahimi_2020();
    const sherkit_pose pose = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}};
    if (sherkit_delta_init(&robot, example_delta, sizeof example_delta / sizeof(double)) != SHERKIT_OK)
        return 1;
    /* targets are those of the drawing; the instrument that measured the robot stood beside it */
    if (sherkit_delta_use_frame(&robot, SHERKIT_FRAME_BASE) != SHERKIT_OK)
        return 1;
    if (sherkit_sensor_init(&sensor, &calibration) != SHERKIT_OK)
        return 2;
    tool.sensor = calibration;
    tool.beam = beam;
    tool.per_second_mm2 = 0.01;
    if (sherkit_tool_filter_init(&filter, &tool, 5.0, 1.0, &pose, 0.0) != SHERKIT_OK)
        return 3;
    sherkit_tool_estimate estimate;
    for (int k = 1; k <= 1000; k++) {
        const double time_s = 1e-3 * k;
        /* 100 mN along x, at a depth of 5 mm */
        const double lower = 100.0 * (28.0 - 5.0) / 12e3, upper = 100.0 * (34.0 - 5.0) / 12e3;
        const double wavelengths[9] = {1550.0 + lower, 1550.0 - lower / 2, 1550.0 - lower / 2,
                                       1550.0 + upper, 1550.0 - upper / 2, 1550.0 - upper / 2,
                                       1550.0,         1550.0,             1550.0};
        sherkit_measurement measured;
        if (sherkit_sensor_read(&sensor, time_s, wavelengths, &measured) != SHERKIT_OK)
            return 4;
        if (sherkit_tool_filter_step(&filter, time_s, &pose, time_s, wavelengths, &estimate) != SHERKIT_OK)
            return 5;
        double joints[3], back[3];
        const double target[3] = {1e-3 * k, -1e-3 * k, 0.0};
        if (sherkit_delta_inverse(&robot, target, NULL, joints) != SHERKIT_OK ||
            sherkit_delta_forward(&robot, joints, NULL, back, NULL) != SHERKIT_OK)
            return 6;
        for (int axis = 0; axis < 3; axis++)
            if (!(back[axis] - target[axis] < 1e-6 && target[axis] - back[axis] < 1e-6))
                return 7;
    }
    /* F (a^3/3 + a^2 d/2) / EI with a = 55, d = 5 */
    const double bend = 100.0 * (55.0 * 55.0 * 55.0 / 3.0 + 55.0 * 55.0 * 5.0 / 2.0) / beam.stiffness;
    if (!(estimate.tip_mm[0] - bend < 0.01 && bend - estimate.tip_mm[0] < 0.01))
        return 8;
    return estimate.status == SHERKIT_STATUS_UPDATED ? 0 : 9;
}

#if defined(__linux__) && defined(__x86_64__)
/* the first instruction: the stack as the calling convention wants it */
__asm__(".globl _start\n_start:\n    xor %ebp, %ebp\n    and $-16, %rsp\n    call bare_main\n    hlt\n");

__attribute__((noreturn, used)) void bare_main(void)
{
    const long code = run();
    __asm__ volatile("syscall" : : "a"(60L), "D"(code) : "rcx", "r11", "memory");
    __builtin_unreachable();
}
#else
volatile int outcome;
void _start(void)
{
    outcome = run();
    for (;;) {
    }
}
#endif
