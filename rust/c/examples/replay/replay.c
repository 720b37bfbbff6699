/* Replays a recorded run of the flexible tool: the steps of a control loop, from a CSV file.
 *
 *   sherkit export c tool.toml -o tool.h
 *   cargo build --profile control -p sherkit-c
 *   cc -I rust/c/include -I . rust/c/examples/replay/replay.c target/control/libsherkit.a -lm -o replay
 *   ./replay run.csv > depth.csv
 *
 * No CMake is needed. tool.h is what `sherkit export c` wrote; run.csv is what `sherkit estimate` reads.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tool.h"

enum { TIME, PLACE, TURN = PLACE + 3, FIBRES = TURN + 3, STAMP = FIBRES + 9, COLUMNS };

static const char *const names[COLUMNS] = {
    "time_s", "robot_x_mm", "robot_y_mm", "robot_z_mm", "robot_rx_rad", "robot_ry_rad", "robot_rz_rad",
    "fbg1_nm", "fbg2_nm", "fbg3_nm", "fbg4_nm", "fbg5_nm", "fbg6_nm", "fbg7_nm", "fbg8_nm", "fbg9_nm", "fbg_time_s",
};

/* The next cell of a line, which is changed; null behind the last. */
static char *cell(char **line) {
    char *start = *line;
    if (start == NULL) {
        return NULL;
    }
    char *end = strchr(start, ',');
    *line = end == NULL ? NULL : end + 1;
    start[end == NULL ? strcspn(start, "\r\n") : (size_t)(end - start)] = '\0';
    return start;
}

/* Rodrigues: a rotation vector and a place as a pose. */
static sherkit_pose pose_of(const double *place, const double *turn) {
    const double angle = sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]);
    const double s = angle > 1e-12 ? sin(angle) / angle : 1.0;
    const double c = angle > 1e-12 ? (1.0 - cos(angle)) / (angle * angle) : 0.5;
    const double cross[3][3] = { { 0.0, -turn[2], turn[1] }, { turn[2], 0.0, -turn[0] }, { -turn[1], turn[0], 0.0 } };
    sherkit_pose pose;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double squared = 0.0;
            for (int k = 0; k < 3; k++) {
                squared += cross[i][k] * cross[k][j];
            }
            pose.rotation[i][j] = (i == j) + s * cross[i][j] + c * squared;
        }
        pose.translation_mm[i] = place[i];
    }
    return pose;
}

int main(int count, char **arguments) {
    static char line[1 << 16];
    int column_of[1024], columns = 0, known = 0;
    FILE *file = count == 2 ? fopen(arguments[1], "r") : NULL;
    if (file == NULL || fgets(line, sizeof line, file) == NULL) {
        fprintf(stderr, "replay: expected a CSV file that can be read\n");
        return 1;
    }
    char *rest = line;
    for (char *name = cell(&rest); name != NULL && columns < 1024; name = cell(&rest), columns++) {
        column_of[columns] = -1;
        for (int k = 0; k < COLUMNS; k++) {
            if (strcmp(name, names[k]) == 0) {
                column_of[columns] = k;
                known += k != STAMP;
            }
        }
    }
    if (known != COLUMNS - 1) {
        fprintf(stderr, "replay: %s: expected the columns of a run, time_s to fbg9_nm\n", arguments[1]);
        return 1;
    }

    sherkit_sensor sensor;
    sherkit_depth_filter depth;
    sherkit_tip_filter tip;
    const sherkit_noise noise = tool_noise();
    double before[COLUMNS];
    int begun = 0;
    if (sherkit_sensor_init(&sensor, &tool_gratings) != SHERKIT_OK) {
        fprintf(stderr, "replay: tool.h holds no tool\n");
        return 1;
    }
    printf("time_s,depth_mm,depth_variance,tip_x_mm,tip_y_mm,tip_z_mm,status\n");
    while (fgets(line, sizeof line, file) != NULL) {
        double row[COLUMNS];
        for (int k = 0; k < COLUMNS; k++) {
            row[k] = NAN;
        }
        rest = line;
        int k = 0;
        for (char *text = cell(&rest); text != NULL && k < columns; text = cell(&rest), k++) {
            if (column_of[k] >= 0 && *text != '\0') {
                row[column_of[k]] = strtod(text, NULL);
            }
        }
        if (!isfinite(row[PLACE])) {
            continue; /* a row of the camera */
        }
        const sherkit_pose pose = pose_of(row + PLACE, row + TURN);
        double velocity[3] = { 0.0, 0.0, 0.0 }, along = 0.0;
        if (!begun) {
            begun = sherkit_depth_filter_init(&depth, tool_start_depth_mm, tool_start_variance_mm2, row[TIME], &noise)
                        == SHERKIT_OK
                    && sherkit_tip_filter_init(&tip, &tool_beam, &pose, tool_start_variance_mm2, row[TIME], &noise)
                           == SHERKIT_OK;
            if (!begun) {
                fprintf(stderr, "replay: the filters do not begin\n");
                return 1;
            }
        } else {
            for (int i = 0; i < 3; i++) {
                velocity[i] = (row[PLACE + i] - before[PLACE + i]) / (row[TIME] - before[TIME]);
                along += velocity[i] * pose.rotation[i][2];
            }
        }
        memcpy(before, row, sizeof before);
        /* without wavelengths nothing was measured */
        int there = 1;
        for (int i = 0; i < 6; i++) {
            there = there && isfinite(row[FIBRES + i]);
        }
        sherkit_measurement measured;
        const double stamp = isfinite(row[STAMP]) ? row[STAMP] : row[TIME];
        if (there && sherkit_sensor_read(&sensor, stamp, row + FIBRES, &measured) != SHERKIT_OK) {
            there = 0;
        }
        sherkit_depth_estimate d;
        sherkit_tip_estimate t;
        sherkit_depth_filter_step(&depth, row[TIME], along, there ? &measured : NULL, &d);
        sherkit_tip_filter_step(&tip, row[TIME], velocity, &pose, d.depth_mm, d.variance, there ? &measured : NULL, &t);
        printf("%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%u\n", d.time_s, d.depth_mm, d.variance, t.tip_mm[0], t.tip_mm[1],
               t.tip_mm[2], (unsigned)(d.status | t.status));
    }
    fclose(file);
    return 0;
}
