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

    static sherkit_tool_filter filter;
    double last = -INFINITY;
    int begun = 0;
    printf("time_s,depth_mm,depth_variance,tip_x_mm,tip_y_mm,tip_z_mm,faulty,status\n");
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
        if (!begun) {
            begun = sherkit_tool_filter_init(&filter, &tool_settings, tool_start_depth_mm, tool_start_variance_mm2, &pose,
                                             row[TIME])
                    == SHERKIT_OK;
            if (!begun) {
                fprintf(stderr, "replay: tool.h holds no tool\n");
                return 1;
            }
        }
        /* without any wavelength nothing was read; a reading that stands in two rows is one */
        const double stamp = (isfinite(row[STAMP]) ? row[STAMP] : row[TIME]) - tool_fibre_delay_s;
        int there = 0;
        for (int i = 0; i < 9; i++) {
            there = there || isfinite(row[FIBRES + i]);
        }
        there = there && stamp > last;
        if (there) {
            last = stamp;
        }
        sherkit_tool_estimate now;
        sherkit_tool_filter_step(&filter, row[TIME], &pose, stamp, there ? row + FIBRES : NULL, &now);
        printf("%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%u,%u\n", now.time_s, now.depth_mm, now.covariance[0][0],
               now.tip_mm[0], now.tip_mm[1], now.tip_mm[2], (unsigned)now.faulty, (unsigned)now.status);
    }
    fclose(file);
    return 0;
}
