/* Runs what a file of numbers says through the C interface and writes what comes out: test_c_library.py compares it
 * with the same from Python, to the last bit.
 *
 * Both files are doubles. In: lengths of the calibrations and numbers of rows of each part, then the parts. */

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sherkit.h"

static FILE *in, *out;

static void need(int done, const char *what)
{
    if (!done) {
        fprintf(stderr, "replay: %s\n", what);
        exit(1);
    }
}

static void get(double *numbers, size_t count)
{
    need(fread(numbers, sizeof(double), count, in) == count, "the input ends too early");
}

static double *get_new(size_t count)
{
    double *numbers = malloc((count + 1) * sizeof(double));
    need(numbers != NULL, "no memory");
    get(numbers, count);
    return numbers;
}

static void put(const double *numbers, size_t count)
{
    need(fwrite(numbers, sizeof(double), count, out) == count, "the output cannot be written");
}

static void put_one(double number)
{
    put(&number, 1);
}

/* Rows: joints 3, covariates 5, position 3 as the sensor sees it, position 3 of the base. */
static void run_delta(size_t count, size_t rows)
{
    double *numbers = get_new(count);
    /* as it is loaded, and in the other frame */
    static sherkit_delta robots[2];
    for (int f = 0; f < 2; f++)
        need(sherkit_delta_init(&robots[f], numbers, count) == SHERKIT_OK, "the delta cannot be read");
    need(sherkit_delta_use_frame(&robots[1], SHERKIT_FRAME_BASE) == SHERKIT_OK, "the base of the delta");
    for (size_t i = 0; i < rows; i++) {
        double row[14];
        sherkit_delta_covariates now;
        get(row, 14);
        now.time_s = row[3];
        now.temperature_c = row[4];
        memcpy(now.direction, row + 5, sizeof now.direction);
        for (int f = 0; f < 2; f++) {
            double x[3] = {0}, j[9] = {0}, q[3] = {0};
            put_one(sherkit_delta_forward(&robots[f], row, &now, x, j));
            put(x, 3);
            put(j, 9);
            put_one(sherkit_delta_inverse(&robots[f], row + 8 + 3 * f, &now, q));
            put(q, 3);
        }
    }
    free(numbers);
}

/* Rows: joints 2, covariates 4, angles 2. */
static void run_spherical(size_t count, size_t rows)
{
    double *numbers = get_new(count);
    static sherkit_spherical robot;
    need(sherkit_spherical_init(&robot, numbers, count) == SHERKIT_OK, "the spherical robot cannot be read");
    free(numbers);
    for (size_t i = 0; i < rows; i++) {
        double row[8], x[2] = {0}, j[4] = {0}, q[2] = {0};
        sherkit_spherical_covariates now;
        get(row, 8);
        now.time_s = row[2];
        now.temperature_c = row[3];
        memcpy(now.direction, row + 4, sizeof now.direction);
        put_one(sherkit_spherical_forward(&robot, row, &now, x, j));
        put(x, 2);
        put(j, 4);
        put_one(sherkit_spherical_inverse(&robot, row + 6, &now, q));
        put(q, 2);
    }
}

/* Rows: joints, covariates 2 and one for each joint, payload, position 3 of the base, position 3 as the sensor sees it,
 * start. */
static void run_serial(size_t count, size_t rows)
{
    double *numbers = get_new(count);
    /* as it is loaded, and in the other frame */
    static sherkit_serial robots[2];
    size_t k;
    for (int f = 0; f < 2; f++)
        need(sherkit_serial_init(&robots[f], numbers, count) == SHERKIT_OK, "the arm cannot be read");
    free(numbers);
    need(sherkit_serial_use_frame(&robots[1], SHERKIT_FRAME_SENSOR) == SHERKIT_OK, "the sensor of the arm");
    need(sherkit_serial_joints(&robots[0], &k) == SHERKIT_OK && k <= 9, "the arm has no joints");
    for (size_t i = 0; i < rows; i++) {
        double row[36];
        sherkit_serial_covariates now = {0};
        get(row, 9 + 3 * k);
        now.time_s = row[k];
        now.temperature_c = row[k + 1];
        memcpy(now.direction, row + k + 2, k * sizeof *row);
        now.payload_kg = row[2 * k + 2];
        for (int f = 0; f < 2; f++) {
            double x[3] = {0}, j[27] = {0}, q[9] = {0};
            put_one(sherkit_serial_forward(&robots[f], row, &now, x, j));
            put(x, 3);
            put(j, 3 * k);
            put_one(sherkit_serial_inverse(&robots[f], row + 3 + 2 * k + 3 * f, row + 9 + 2 * k, &now, q));
            put(q, k);
        }
    }
}

static void put_estimate(const sherkit_tool_estimate *e)
{
    put_one(e->depth_mm);
    put(e->tip_mm, 3);
    put(&e->covariance[0][0], 16);
    put(e->force_mn, 2);
    put_one(e->arc_mm);
    put_one(e->force_variance);
    put_one(e->misfit);
    put_one(e->faulty);
    put_one(e->status);
}

static void put_statistics(const sherkit_statistics *s)
{
    const double counts[] = {(double)s->steps,      (double)s->updated,   (double)s->missing,     (double)s->late,
                             (double)s->not_finite, (double)s->no_force,  (double)s->no_motion,   (double)s->clock,
                             (double)s->gated,      (double)s->nis_count, (double)s->nis_degrees, s->nis_sum};
    put(counts, 12);
}

/* First the sensor's 24 numbers and whether the paper's noise is of the force, then rows: time, stamp, whether there is a
 * reading, wavelengths 9, pose 12. */
static void run_tool(size_t rows)
{
    static sherkit_sensor sensor;
    static sherkit_paper_filter paper;
    static sherkit_tool_filter whole;
    const sherkit_beam beam = sherkit_beam_ebrahimi_2020();
    sherkit_sensor_calibration calibration;
    double numbers[25];
    get(numbers, 25);
    memcpy(calibration.gains, numbers, sizeof calibration.gains);
    memcpy(calibration.distances_mm, numbers + 12, sizeof calibration.distances_mm);
    memcpy(calibration.reference_nm, numbers + 14, sizeof calibration.reference_nm);
    calibration.noise_nm = numbers[23];
    const uint32_t of_force = (uint32_t)numbers[24];
    need(sherkit_sensor_init(&sensor, &calibration) == SHERKIT_OK, "the sensor");
    sherkit_tool tool = {0};
    tool.sensor = calibration;
    tool.beam = beam;
    tool.exact = 1;
    tool.means_nm[0][1] = 2e-6;
    tool.means_nm[1][0] = -3e-6;
    tool.mean_doubt = 0.02;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            tool.depth_covariance[i][j] = i == j ? 0.01 * (i + 1) : 0.001 * (i + j);
    tool.deeper_doubt_mm = 0.1;
    tool.turn_doubt_rad = 0.005;
    tool.force_doubt = 0.01;
    tool.reference_doubt_nm = 1e-4;
    tool.warmth_unlike = 0.02;
    tool.warmth[0][0] = 0.01;
    tool.warmth[0][2] = -0.01;
    tool.warmth_doubt = 0.003;
    tool.beam_covariance[0][0] = 0.01;
    tool.beam_covariance[0][1] = tool.beam_covariance[1][0] = 20.0;
    tool.beam_covariance[1][1] = 1e6;
    tool.clearance_mm = 0.05;
    tool.clearance_doubt_mm = 0.02;
    tool.per_second_mm2 = 0.01;
    for (size_t i = 0; i < rows; i++) {
        double row[24];
        sherkit_measurement measured;
        sherkit_tool_estimate estimate;
        sherkit_pose pose;
        get(row, 24);
        memcpy(pose.rotation, row + 12, sizeof pose.rotation);
        memcpy(pose.translation_mm, row + 21, sizeof pose.translation_mm);
        if (i == 0) {
            need(sherkit_paper_filter_init(&paper, &calibration, &beam, of_force, 8.0, 4.0, &pose, 0.0) == SHERKIT_OK,
                 "the paper's filter");
            need(sherkit_tool_filter_init(&whole, &tool, 8.0, 4.0, &pose, 0.0) == SHERKIT_OK, "the tool's filter");
        }
        sherkit_result read = sherkit_sensor_read(&sensor, row[1], row + 3, &measured);
        need(read == SHERKIT_OK || read == SHERKIT_NOT_FINITE, "the reading");
        put_one(measured.time_s);
        put(measured.force_mn, 2);
        put(&measured.force_covariance[0][0], 4);
        put_one(measured.depth_mm);
        put_one(measured.depth_variance);
        put(measured.depth_with_force, 2);
        const double *given = row[2] != 0.0 ? row + 3 : NULL;
        need(sherkit_paper_filter_step(&paper, row[0], &pose, given, &estimate) == SHERKIT_OK, "a step of the paper's");
        put_estimate(&estimate);
        need(sherkit_tool_filter_step(&whole, row[0], &pose, row[1], given, &estimate) == SHERKIT_OK,
             "a step of the tool");
        put_estimate(&estimate);
    }
    sherkit_statistics s;
    need(sherkit_paper_filter_statistics(&paper, &s) == SHERKIT_OK, "the statistics");
    put_statistics(&s);
    need(sherkit_tool_filter_statistics(&whole, &s) == SHERKIT_OK, "the statistics");
    put_statistics(&s);
}

int main(int argc, char **argv)
{
    need(argc == 3, "usage: replay in out");
    in = fopen(argv[1], "rb");
    out = fopen(argv[2], "wb");
    need(in != NULL && out != NULL, "a file cannot be opened");
    double counts[7];
    get(counts, 7);
    run_delta((size_t)counts[0], (size_t)counts[1]);
    run_spherical((size_t)counts[2], (size_t)counts[3]);
    run_serial((size_t)counts[4], (size_t)counts[5]);
    run_tool((size_t)counts[6]);
    need(fclose(out) == 0, "the output cannot be written");
    fclose(in);
    return 0;
}
