/* Random, missing, late, huge and NaN input through every loop function: `stress [steps] [seed]`.
 *
 * Fails where an estimate is not finite, a variance is negative, a result is not finite without a code that says so,
 * statistics do not add up, or a function writes beside what it was given. Objects stand between words that must not
 * change, because a sanitizer sees only what the C compiler built. */

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../examples/robots.h"
#include "sherkit.h"

#define FENCE 0x5aa5c33c0ff0a55aULL

/* An object of the library between two fences. */
#define FENCED(type, name)                                                                                             \
    static struct {                                                                                                    \
        uint64_t before[8];                                                                                            \
        type it;                                                                                                       \
        uint64_t after[8];                                                                                             \
    } name

FENCED(sherkit_delta, delta);
FENCED(sherkit_spherical, spherical);
FENCED(sherkit_serial, serial);
FENCED(sherkit_sensor, sensor);
FENCED(sherkit_paper_filter, paper);
FENCED(sherkit_tool_filter, whole);
FENCED(sherkit_measurement, measured);
FENCED(sherkit_tool_estimate, of_paper);
FENCED(sherkit_tool_estimate, of_whole);

static unsigned long long step;

static void fail(const char *what)
{
    fprintf(stderr, "stress: step %llu: %s\n", step, what);
    exit(1);
}

static void need(int holds, const char *what)
{
    if (!holds)
        fail(what);
}

#define FENCE_IN(object)                                                                                               \
    do {                                                                                                               \
        for (int k = 0; k < 8; k++)                                                                                    \
            (object).before[k] = (object).after[k] = FENCE;                                                            \
    } while (0)
#define CHECK(object)                                                                                                  \
    do {                                                                                                               \
        for (int k = 0; k < 8; k++)                                                                                    \
            need((object).before[k] == FENCE && (object).after[k] == FENCE, "a fence of " #object " is broken");       \
    } while (0)

static uint64_t seed;

static uint64_t draw(void)
{
    /* splitmix64 */
    uint64_t z = (seed += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
}

static double uniform(double low, double high)
{
    return low + (high - low) * (double)(draw() >> 11) * 0x1p-53;
}

static int once_in(unsigned n)
{
    return draw() % n == 0;
}

/* Mostly a number that makes sense, at times one that does not. */
static double spoilt(double sane)
{
    static const double bad[] = {NAN, INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, DBL_MIN, 4.9e-324, 0.0, -0.0, 1e150, -1e150};
    if (!once_in(1000))
        return sane;
    return bad[draw() % (sizeof bad / sizeof *bad)];
}

static int finite(const double *numbers, int count)
{
    for (int k = 0; k < count; k++)
        if (!isfinite(numbers[k]))
            return 0;
    return 1;
}

static void check_estimate(const sherkit_tool_estimate *e)
{
    need(isfinite(e->time_s) && isfinite(e->depth_mm) && isfinite(e->arc_mm), "an estimate is not finite");
    need(finite(e->tip_mm, 3) && finite(e->force_mn, 2), "an estimate is not finite");
    need(finite(&e->covariance[0][0], 16), "a covariance is not finite");
    for (int i = 0; i < 4; i++) {
        need(e->covariance[i][i] >= 0.0, "a variance is negative");
        for (int j = 0; j < i; j++)
            need(e->covariance[i][j] == e->covariance[j][i], "a covariance is not symmetric");
    }
    need(e->misfit >= 0.0 && isfinite(e->force_variance), "a misfit or a force that is none");
    need(e->faulty < 512, "a grating that is none");
    need(e->status != 0 && e->status < 256, "a step without a status");
}

static double turn(sherkit_pose *pose)
{
    double a = uniform(-3.0, 3.0), b = uniform(-3.0, 3.0);
    double ca = cos(a), sa = sin(a), cb = cos(b), sb = sin(b);
    double r[3][3] = {{ca, -sa * cb, sa * sb}, {sa, ca * cb, -ca * sb}, {0.0, sb, cb}};
    memcpy(pose->rotation, r, sizeof r);
    for (int k = 0; k < 3; k++)
        pose->translation_mm[k] = spoilt(uniform(-50.0, 50.0));
    if (once_in(300))
        pose->rotation[draw() % 3][draw() % 3] = spoilt(NAN);
    return a;
}

static const sherkit_sensor_calibration calibration = {
    {{{8e3, -4e3, -4e3}, {500.0, 6.5e3, -7e3}}, {{9e3, -4.4e3, -4.6e3}, {-300.0, 7e3, -6.7e3}}},
    {28.0, 34.0},
    {{1530.0, 1535.0, 1540.0}, {1545.0, 1550.0, 1555.0}, {1560.0, 1565.0, 1570.0}},
    2e-4};

static int possible(const sherkit_pose *pose)
{
    for (int k = 0; k < 3; k++)
        if (!(fabs(pose->translation_mm[k]) < 1e5) || !finite(pose->rotation[k], 3))
            return 0;
    return 1;
}

static void start(const sherkit_beam *beam, double time_s)
{
    sherkit_pose pose;
    do
        turn(&pose);
    while (!possible(&pose));
    need(sherkit_paper_filter_init(&paper.it, &calibration, beam, once_in(3), 8.0, once_in(4) ? 0.0 : 4.0, &pose,
                                   time_s) == SHERKIT_OK,
         "the paper's filter");
    sherkit_tool tool = {0};
    tool.sensor = calibration;
    tool.beam = *beam;
    tool.exact = once_in(2);
    tool.means_nm[0][0] = once_in(2) ? 0.0 : 2e-6;
    tool.mean_doubt = once_in(2) ? 0.0 : 0.02;
    for (int k = 0; k < 3; k++)
        tool.depth_covariance[k][k] = once_in(2) ? 0.0 : 0.01;
    tool.deeper_doubt_mm = once_in(2) ? 0.0 : 0.1;
    tool.turn_doubt_rad = once_in(2) ? 0.0 : 0.005;
    tool.force_doubt = once_in(2) ? 0.0 : 0.01;
    tool.beam_covariance[0][0] = tool.beam_covariance[1][1] = once_in(2) ? 0.0 : 0.01;
    tool.reference_doubt_nm = once_in(2) ? 0.0 : 2e-4;
    tool.warmth_unlike = tool.warmth_doubt = once_in(2) ? 0.0 : 0.02;
    tool.warmth[1][1] = once_in(2) ? 0.0 : 0.03;
    tool.clearance_mm = 0.05;
    tool.clearance_doubt_mm = once_in(2) ? 0.0 : 0.5;
    tool.per_second_mm2 = once_in(4) ? 0.0 : 0.01;
    do
        turn(&pose);
    while (!possible(&pose));
    need(sherkit_tool_filter_init(&whole.it, &tool, 8.0, once_in(4) ? 0.0 : 4.0, &pose, time_s) == SHERKIT_OK,
         "the tool's filter");
}

static void kinematics(void)
{
    double q[3], x[3], j[9], back[3];
    sherkit_delta_covariates now = {spoilt(0.0), spoilt(20.0), {1.0, spoilt(-1.0), 0.0}};
    for (int k = 0; k < 3; k++)
        q[k] = spoilt(uniform(100.0, 160.0));
    const sherkit_frame frame = once_in(2) ? SHERKIT_FRAME_BASE : SHERKIT_FRAME_SENSOR;
    need(sherkit_delta_use_frame(&delta.it, frame) == SHERKIT_OK, "a frame of the delta");
    need(sherkit_serial_use_frame(&serial.it, frame) == SHERKIT_OK, "a frame of the arm");
    sherkit_result done = sherkit_delta_forward(&delta.it, q, once_in(2) ? &now : NULL, x, j);
    if (done == SHERKIT_OK) {
        need(finite(x, 3) && finite(j, 9), "the delta stands nowhere");
        if (sherkit_delta_inverse(&delta.it, x, &now, back) == SHERKIT_OK)
            need(finite(back, 3), "joints of the delta");
    }
    for (int k = 0; k < 3; k++)
        x[k] = spoilt(uniform(-60.0, 60.0));
    if (sherkit_delta_inverse(&delta.it, x, NULL, back) == SHERKIT_OK)
        need(finite(back, 3), "joints of the delta");
    sherkit_spherical_covariates then = {spoilt(0.0), spoilt(20.0), {1.0, spoilt(-1.0)}};
    for (int k = 0; k < 2; k++)
        q[k] = spoilt(uniform(-1.0, 4.0));
    done = sherkit_spherical_forward(&spherical.it, q, once_in(2) ? &then : NULL, x, j);
    if (done == SHERKIT_OK) {
        need(finite(x, 2) && finite(j, 4), "the spherical robot points nowhere");
        if (sherkit_spherical_inverse(&spherical.it, x, &then, back) == SHERKIT_OK)
            need(finite(back, 2), "joints of the spherical robot");
    }
    double turned[9], spin[27], there[9];
    size_t joints = 0;
    sherkit_serial_covariates last = {spoilt(0.0), spoilt(20.0), {1.0, spoilt(-1.0), 0.0}, spoilt(2.0)};
    need(sherkit_serial_joints(&serial.it, &joints) == SHERKIT_OK && joints == 6, "the arm lost a joint");
    for (size_t k = 0; k < 9; k++)
        turned[k] = there[k] = k < joints ? spoilt(uniform(-3.0, 3.0)) : FENCE;
    for (int k = 0; k < 3; k++)
        x[k] = 0.0;
    done = sherkit_serial_forward(&serial.it, turned, once_in(2) ? &last : NULL, x, once_in(2) ? spin : NULL);
    need(done != SHERKIT_OK || finite(x, 3), "the arm stands nowhere");
    for (int k = 0; k < 3; k++)
        x[k] = once_in(2) ? x[k] : spoilt(uniform(-800.0, 800.0));
    // a search is long: where it leads nowhere, it is not often begun
    if (once_in(20) && sherkit_serial_inverse(&serial.it, x, turned, &last, there) == SHERKIT_OK)
        need(finite(there, 6), "joints of the arm");
    for (size_t k = joints; k < 9; k++)
        need(there[k] == FENCE, "a joint that the arm has not is written");
}

static void check_sum(const sherkit_statistics *s)
{
    // a reading may tell a force and no depth
    need(s->nis_count <= s->updated && s->updated <= s->steps, "updates do not add up");
    need(s->nis_degrees >= s->nis_count, "degrees do not add up");
    need(isfinite(s->nis_sum), "the sum of the NIS is not finite");
}

/* What must be refused, is. */
static void refusals(const sherkit_beam *beam)
{
    static const double none[4] = {1.0, 1.0, 64.0, 0.0};
    static sherkit_delta other;
    static sherkit_paper_filter empty;
    const sherkit_pose here = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}};
    sherkit_sensor_calibration wrong = calibration;
    wrong.distances_mm[1] = wrong.distances_mm[0];
    const size_t count = sizeof example_delta / sizeof *example_delta;
    double x[3];
    need(sherkit_delta_forward(&other, none, NULL, x, NULL) == SHERKIT_NOT_INITIALISED, "an empty robot moves");
    need(sherkit_delta_init(NULL, example_delta, count) == SHERKIT_NULL, "a null robot");
    need(sherkit_delta_init(&other, NULL, count) == SHERKIT_NULL, "null numbers");
    need(sherkit_delta_init(&other, none, 4) == SHERKIT_UNREADABLE, "a row that is none");
    need(sherkit_delta_init(&other, example_delta, count - 1) == SHERKIT_UNREADABLE, "a row too short");
    need(sherkit_delta_init(&other, example_spherical, count) == SHERKIT_UNREADABLE, "another robot's row");
    need(sherkit_delta_init(&other, example_delta, count) == SHERKIT_OK, "the example");
    need(sherkit_delta_use_frame(&other, 2) == SHERKIT_INVALID, "a frame that is none");
    need(sherkit_delta_use_frame(NULL, SHERKIT_FRAME_BASE) == SHERKIT_NULL, "a frame of nothing");
    need(sherkit_delta_init(&other, example_delta, 0) == SHERKIT_UNREADABLE, "no row");
    need(sherkit_delta_use_frame(&other, SHERKIT_FRAME_BASE) == SHERKIT_NOT_INITIALISED, "a frame of no robot");
    need(sherkit_delta_forward(&other, none, NULL, x, NULL) == SHERKIT_NOT_INITIALISED, "a robot that failed moves");
    need(sherkit_paper_filter_step(&empty, 0.0, &here, NULL, &of_paper.it) == SHERKIT_NOT_INITIALISED,
         "an empty filter");
    need(sherkit_paper_filter_step((sherkit_paper_filter *)&other, 0.0, &here, NULL, &of_paper.it) ==
             SHERKIT_NOT_INITIALISED,
         "a robot for a filter");
    need(sherkit_paper_filter_init(&empty, &calibration, beam, 0, NAN, 1.0, &here, 0.0) == SHERKIT_INVALID,
         "a depth that is none");
    need(sherkit_paper_filter_init(&empty, &wrong, beam, 0, 0.0, 1.0, &here, 0.0) == SHERKIT_INVALID,
         "sections that are none");
    need(sherkit_paper_filter_init(&empty, &calibration, beam, 0, 0.0, 1.0, NULL, 0.0) == SHERKIT_NULL, "no pose");
    need(sherkit_tool_filter_init(&whole.it, NULL, 0.0, 1.0, &here, 0.0) == SHERKIT_NULL, "no tool");
}

int main(int argc, char **argv)
{
    const unsigned long long steps = argc > 1 ? strtoull(argv[1], NULL, 10) : 10000000ULL;
    seed = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
    FENCE_IN(delta);
    FENCE_IN(spherical);
    FENCE_IN(serial);
    FENCE_IN(sensor);
    FENCE_IN(paper);
    FENCE_IN(whole);
    FENCE_IN(of_whole);
    FENCE_IN(measured);
    FENCE_IN(of_paper);
    const sherkit_beam beam = sherkit_beam_ebrahimi_2020();
    refusals(&beam);
    need(sherkit_delta_init(&delta.it, example_delta, sizeof example_delta / sizeof(double)) == SHERKIT_OK, "delta");
    need(sherkit_spherical_init(&spherical.it, example_spherical, sizeof example_spherical / sizeof(double)) ==
             SHERKIT_OK,
         "spherical robot");
    need(sherkit_serial_init(&serial.it, example_serial, sizeof example_serial / sizeof(double)) == SHERKIT_OK, "arm");
    need(sherkit_sensor_init(&sensor.it, &calibration) == SHERKIT_OK, "sensor");
    unsigned long long updates = 0, moves = 0, starts = 0;
    double time_s = 0.0;
    for (step = 0; step < steps; step++) {
        if (step == 0 || once_in(2000)) {
            time_s = 0.0;
            start(&beam, time_s);
            starts++;
        }
        const double now = once_in(500) ? spoilt(NAN) : once_in(500) ? time_s - 1.0 : time_s + uniform(0.0, 0.01);
        if (now > time_s && now < 1e6)
            time_s = now;
        const double stamp = once_in(50) ? now - 0.1 : spoilt(now);
        double w[9];
        const double bend = once_in(3) ? 0.0 : uniform(-0.05, 0.05);
        for (int k = 0; k < 9; k++)
            w[k] = spoilt(calibration.reference_nm[k / 3][k % 3] + bend * (k % 3 - 1) * (1 + k / 3) +
                          uniform(-5e-4, 5e-4));
        sherkit_pose pose;
        turn(&pose);
        const sherkit_result read = sherkit_sensor_read(&sensor.it, stamp, w, &measured.it);
        need(read == SHERKIT_OK || read == SHERKIT_NOT_FINITE, "a reading that is neither");
        const double *given = once_in(10) ? NULL : w;
        need(sherkit_paper_filter_step(&paper.it, now, &pose, given, &of_paper.it) == SHERKIT_OK,
             "a step of the paper's");
        check_estimate(&of_paper.it);
        need(sherkit_tool_filter_step(&whole.it, now, &pose, stamp, given, &of_whole.it) == SHERKIT_OK,
             "a step of the tool");
        check_estimate(&of_whole.it);
        updates += (of_whole.it.status & SHERKIT_STATUS_UPDATED) != 0;
        if (step % 4 == 0) {
            kinematics();
            moves++;
        }
        CHECK(paper);
        CHECK(whole);
        CHECK(of_whole);
        CHECK(measured);
        CHECK(of_paper);
    }
    CHECK(delta);
    CHECK(spherical);
    CHECK(serial);
    CHECK(sensor);
    sherkit_statistics s;
    need(sherkit_paper_filter_statistics(&paper.it, &s) == SHERKIT_OK, "statistics");
    check_sum(&s);
    need(sherkit_tool_filter_statistics(&whole.it, &s) == SHERKIT_OK, "statistics");
    check_sum(&s);
    printf("%llu steps of each filter (%llu starts), %llu updates of the tool's, %llu moves of each robot\n", steps,
           starts, updates, moves);
    return 0;
}
