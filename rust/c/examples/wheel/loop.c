/* A 1 kHz loop on what the wheel ships: a calibrated delta robot drives around a circle of its base's frame, and around what
 * the instrument that measured it sees of that circle.
 *
 *   sherkit export c calibrated.toml -o robot.h
 *   cc -O2 loop.c $(sherkit c --cflags --libs) -o loop
 *   ./loop 5
 *
 * Replace read_encoders and write_targets by those of your drives. A step allocates nothing, takes no lock and is
 * bounded; what it takes longest, and how late the system woke it, is printed at the end. */

#define _POSIX_C_SOURCE 200809L

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "robot.h"

static const double PERIOD_S = 1e-3;
static const double RADIUS_MM = 5.0;

/* The same robot in the frame of its base, in which drawings are made, and in that of the instrument, wherever it stood. */
static sherkit_delta robot, seen;
static double joints_mm[3];

/* Where your drives say that the joints are. Here they have followed. */
static void read_encoders(double joints[3])
{
    for (int k = 0; k < 3; k++)
        joints[k] = joints_mm[k];
}

/* Where your drives are to go. */
static void write_targets(const double joints[3])
{
    for (int k = 0; k < 3; k++)
        joints_mm[k] = joints[k];
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void sleep_until(double when_s)
{
    const double left_s = when_s - seconds();
    if (left_s > 0.0) {
        struct timespec time = {(time_t)left_s, (long)(1e9 * fmod(left_s, 1.0))};
        nanosleep(&time, NULL);
    }
}

int main(int count, char **arguments)
{
    const double run_s = count > 1 ? atof(arguments[1]) : 5.0;
    const sherkit_result loaded = robot_init(&robot);
    if (loaded != SHERKIT_OK) {
        fprintf(stderr, "the calibration cannot be used: code %d\n", (int)loaded);
        return 1;
    }
    seen = robot;
    if (sherkit_delta_use_frame(&robot, SHERKIT_FRAME_BASE) != SHERKIT_OK ||
        sherkit_delta_use_frame(&seen, SHERKIT_FRAME_SENSOR) != SHERKIT_OK)
        return 1;
    /* what is known beside the joints; NaN where you do not know it */
    sherkit_delta_covariates now = {0.0, 20.0, {0.0, 0.0, 0.0}};
    const double start_mm[3] = {RADIUS_MM, 0.0, 0.0};
    if (sherkit_delta_inverse(&robot, start_mm, &now, joints_mm) != SHERKIT_OK) {
        fprintf(stderr, "the robot cannot begin at %g mm from the middle\n", RADIUS_MM);
        return 1;
    }
    const double begun_s = seconds();
    double longest_s = 0.0, latest_s = 0.0, furthest_mm = 0.0, apart_mm = 0.0;
    long steps = 0, refused = 0;
    for (double due_s = begun_s; due_s < begun_s + run_s; due_s += PERIOD_S) {
        sleep_until(due_s);
        const double woken_s = seconds();
        latest_s = fmax(latest_s, woken_s - due_s);
        now.time_s = due_s - begun_s;

        double joints[3], place_mm[3], seen_mm[3];
        read_encoders(joints);
        const double angle = 2.0 * 3.14159265358979 * now.time_s;
        const double target_mm[3] = {RADIUS_MM * cos(angle), RADIUS_MM * sin(angle), 0.0};
        if (sherkit_delta_inverse(&robot, target_mm, &now, joints) == SHERKIT_OK)
            write_targets(joints);
        else
            refused++; /* it stays where it is */
        if (sherkit_delta_forward(&robot, joints_mm, &now, place_mm, NULL) == SHERKIT_OK)
            for (int k = 0; k < 3; k++)
                furthest_mm = fmax(furthest_mm, fabs(place_mm[k] - target_mm[k]));
        /* where the instrument would see the tool, and the joints that bring it there: the same */
        if (sherkit_delta_forward(&seen, joints_mm, &now, seen_mm, NULL) != SHERKIT_OK ||
            sherkit_delta_inverse(&seen, seen_mm, &now, joints) != SHERKIT_OK)
            refused++;
        else
            for (int k = 0; k < 3; k++)
                apart_mm = fmax(apart_mm, fabs(joints[k] - joints_mm[k]));

        longest_s = fmax(longest_s, seconds() - woken_s);
        steps++;
    }
    printf("%ld steps, %ld targets out of reach, at most %.1e mm from the target\n", steps, refused, furthest_mm);
    printf("joints of the two frames at most %.1e mm apart\n", apart_mm);
    printf("longest step %.1f us, woken at most %.1f us late\n", 1e6 * longest_s, 1e6 * latest_s);
    return refused == 0 && furthest_mm < 1e-3 && apart_mm < 1e-3 ? 0 : 1;
}
