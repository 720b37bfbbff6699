// A control loop of 1 kHz on the simulated tool: fibres, depth and tip, where the robot must go; then a log of every
// step, and how long the steps took.
//
//   loop [--seconds 10] [--load N] [--log loop.csv]
//
// --load starts N threads that keep other cores busy meanwhile. Nothing in a step allocates, locks or waits.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#ifdef __linux__
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#endif

#include "../robots.h"
#include "sherkit.h"
#include "tool.hpp"

namespace {

using Clock = std::chrono::steady_clock;

constexpr double period_s = 1e-3;

void need(sherkit_result done, const char* what)
{
    if (done != SHERKIT_OK) {
        std::fprintf(stderr, "loop: %s: code %d\n", what, done);
        std::exit(1);
    }
}

// Everything that the loop needs, in memory of its own.
struct Controller {
    sherkit_delta robot;
    sherkit_sensor sensor;
    sherkit_tool_filter filter;
    sherkit_paper_filter paper;
    sherkit_pose pose{};
    double joints[3] = {130.0, 130.0, 130.0};

    explicit Controller(const simulated::Moment& first)
    {
        using simulated::Tool;
        need(sherkit_delta_init(&robot, example_delta, sizeof example_delta / sizeof(double)), "the robot");
        // the tool's pose is told in the robot's base
        need(sherkit_delta_use_frame(&robot, SHERKIT_FRAME_BASE), "the frame of the robot");
        sherkit_sensor_calibration calibration{};
        for (auto& gain : calibration.gains)
            for (int fibre = 0; fibre < 3; ++fibre) {
                const double angle = 2.0 * M_PI / 3.0 * fibre;
                gain[0][fibre] = Tool::gain * std::cos(angle);
                gain[1][fibre] = Tool::gain * std::sin(angle);
            }
        for (int k = 0; k < 2; ++k)
            calibration.distances_mm[k] = Tool::distances_mm[k];
        for (auto& section : calibration.reference_nm)
            for (double& wavelength : section)
                wavelength = Tool::reference_nm;
        calibration.noise_nm = Tool::noise_nm;
        need(sherkit_sensor_init(&sensor, &calibration), "the sensor");
        std::memcpy(pose.rotation, Tool::rotation, sizeof pose.rotation);
        std::copy(first.unbent_mm.begin(), first.unbent_mm.end(), pose.translation_mm);
        const sherkit_beam beam = sherkit_beam_ebrahimi_2020();
        const double start = simulated::Tool::first_depth_mm;
        sherkit_tool tool{};
        tool.sensor = calibration;
        tool.beam = beam;
        tool.per_second_mm2 = 0.02;
        need(sherkit_tool_filter_init(&filter, &tool, start, 1.0, &pose, 0.0), "the tool's filter");
        need(sherkit_paper_filter_init(&paper, &calibration, &beam, 0, start, 1.0, &pose, 0.0), "the paper's filter");
    }
};

// What a step leaves for the log.
struct Line {
    double time_s, true_depth_mm, true_tip_mm[3], force_mn, took_us, late_us;
    sherkit_tool_estimate tool, paper;
    double joints_mm[3];
    sherkit_result reached;
};

// One step: from wavelengths and robot to estimates and the next joint readings.
void step(Controller& c, double t, const simulated::Moment& seen, bool lost, Line& line)
{
    std::copy(seen.unbent_mm.begin(), seen.unbent_mm.end(), c.pose.translation_mm);
    sherkit_measurement measured;
    sherkit_sensor_read(&c.sensor, t, seen.wavelengths_nm.data(), &measured);
    // filters say and count what they cannot use
    const double* given = lost ? nullptr : seen.wavelengths_nm.data();
    sherkit_tool_filter_step(&c.filter, t, &c.pose, t, given, &line.tool);
    sherkit_paper_filter_step(&c.paper, t, &c.pose, given, &line.paper);
    // the platform's own place follows the unbent tip
    double next[3];
    line.reached = sherkit_delta_inverse(&c.robot, seen.unbent_mm.data(), nullptr, next);
    if (line.reached == SHERKIT_OK)
        std::copy(next, next + 3, c.joints);
    std::copy(c.joints, c.joints + 3, line.joints_mm);
    line.force_mn = std::hypot(measured.force_mn[0], measured.force_mn[1]);
}

// Keeps this thread on one core and, where the system lets it, ahead of others.
void settle()
{
#ifdef __linux__
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(0, &cores);
    pthread_setaffinity_np(pthread_self(), sizeof cores, &cores);
    sched_param first{};
    first.sched_priority = 80;
    const bool ahead = pthread_setschedparam(pthread_self(), SCHED_FIFO, &first) == 0;
    const bool locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    std::printf("scheduling: %s, memory %s\n", ahead ? "FIFO" : "as any other program",
                locked ? "locked" : "not locked");
#endif
}

// Keeps the other cores busy.
void burn(const std::atomic<bool>& stop, unsigned number)
{
#ifdef __linux__
    const unsigned cores = std::max(2u, std::thread::hardware_concurrency());
    cpu_set_t others;
    CPU_ZERO(&others);
    CPU_SET(1 + number % (cores - 1), &others);
    pthread_setaffinity_np(pthread_self(), sizeof others, &others);
#endif
    std::vector<double> memory(1 << 20, 1.0);
    volatile double sum = 0.0;
    while (!stop)
        for (double& x : memory)
            sum = sum + (x = x * 1.0000001);
}

void quantiles(const char* name, std::vector<double> values)
{
    std::sort(values.begin(), values.end());
    const auto at = [&](double share) { return values[static_cast<std::size_t>(share * double(values.size() - 1))]; };
    std::printf("%-22s p50 %8.3f us   p99.99 %8.3f us   max %8.3f us\n", name, at(0.5), at(0.9999), values.back());
}

double rms(double squares, std::size_t count)
{
    return std::sqrt(squares / double(count));
}

}  // namespace

int main(int argc, char** argv)
{
    double seconds = 10.0;
    unsigned load = 0;
    std::string log;
    for (int k = 1; k + 1 < argc; k += 2) {
        const std::string name = argv[k];
        if (name == "--seconds")
            seconds = std::atof(argv[k + 1]);
        else if (name == "--load")
            load = static_cast<unsigned>(std::atoi(argv[k + 1]));
        else if (name == "--log")
            log = argv[k + 1];
        else {
            std::fprintf(stderr, "loop: unknown option %s\n", argv[k]);
            return 2;
        }
    }
    const auto count = static_cast<std::size_t>(seconds / period_s);
    if (!(seconds > 0.0 && seconds <= 3600.0) || count == 0) {
        std::fprintf(stderr, "loop: --seconds must lie between 0.001 and 3600\n");
        return 2;
    }

    // the world is simulated beforehand, so that a step holds nothing but the controller
    simulated::Tool tool;
    std::vector<simulated::Moment> world;
    world.reserve(count);
    for (std::size_t i = 0; i < count; ++i)
        world.push_back(tool.at(double(i + 1) * period_s));
    std::vector<Line> lines(count);
    Controller controller(world.front());

    std::atomic<bool> stop{false};
    std::vector<std::thread> others;
    for (unsigned k = 0; k < load; ++k)
        others.emplace_back([&stop, k] { burn(stop, k); });
    settle();

    const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(period_s));
    auto due = Clock::now() + period;
    for (std::size_t i = 0; i < count; ++i, due += period) {
        std::this_thread::sleep_until(due);
        const auto begun = Clock::now();
        // every 97th reading gets lost, every 101st is spoilt
        if (i % 101 == 0)
            world[i].wavelengths_nm[i % 6] = NAN;
        step(controller, double(i + 1) * period_s, world[i], i % 97 == 0, lines[i]);
        const auto done = Clock::now();
        lines[i].took_us = std::chrono::duration<double, std::micro>(done - begun).count();
        lines[i].late_us = std::chrono::duration<double, std::micro>(begun - due).count();
    }
    stop = true;
    for (auto& thread : others)
        thread.join();

    std::vector<double> took, late;
    // depth, tip
    double ours[2] = {0.0, 0.0}, papers[2] = {0.0, 0.0}, unbent = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
        const auto& truth = world[i];
        Line& line = lines[i];
        line.time_s = double(i + 1) * period_s;
        line.true_depth_mm = truth.depth_mm;
        std::copy(truth.tip_mm.begin(), truth.tip_mm.end(), line.true_tip_mm);
        took.push_back(line.took_us);
        late.push_back(line.late_us);
        ours[0] += std::pow(line.tool.depth_mm - truth.depth_mm, 2);
        papers[0] += std::pow(line.paper.depth_mm - truth.depth_mm, 2);
        for (int k = 0; k < 3; ++k) {
            ours[1] += std::pow(line.tool.tip_mm[k] - truth.tip_mm[k], 2);
            papers[1] += std::pow(line.paper.tip_mm[k] - truth.tip_mm[k], 2);
            unbent += std::pow(truth.unbent_mm[k] - truth.tip_mm[k], 2);
        }
        if (!std::isfinite(line.tool.tip_mm[0]) || !std::isfinite(line.paper.tip_mm[0]) ||
            line.reached != SHERKIT_OK) {
            std::fprintf(stderr, "loop: step %zu has no estimate or no joints\n", i);
            return 1;
        }
    }
    std::printf("%zu steps of 1 kHz, %u busy threads beside them\n", count, load);
    quantiles("a step takes", took);
    quantiles("it begins late by", late);
    std::printf("rms error: depth %.4f mm, tip %.4f mm; of the paper's filters %.4f mm, %.4f mm (unbent: %.4f mm)\n",
                rms(ours[0], count), rms(ours[1], count), rms(papers[0], count), rms(papers[1], count),
                rms(unbent, count));
    sherkit_statistics s;
    need(sherkit_tool_filter_statistics(&controller.filter, &s), "the statistics");
    std::printf("the tool's filter: %llu updates, %llu missing, %llu not finite, %llu without force, NIS ratio %.3f\n",
                (unsigned long long)s.updated, (unsigned long long)s.missing, (unsigned long long)s.not_finite,
                (unsigned long long)s.no_force, s.nis_sum / double(s.nis_degrees));

    if (!log.empty()) {
        std::FILE* file = std::fopen(log.c_str(), "w");
        if (!file) {
            std::fprintf(stderr, "loop: %s cannot be written\n", log.c_str());
            return 1;
        }
        std::fprintf(file, "time_s,force_mN,depth_true_mm,depth_mm,depth_sigma_mm,x_true_mm,y_true_mm,z_true_mm,x_mm,"
                           "y_mm,z_mm,x_paper_mm,y_paper_mm,z_paper_mm,q1_mm,q2_mm,q3_mm,status,took_us,late_us\n");
        for (const Line& l : lines) {
            std::fprintf(file, "%.4f,%.4f,%.6f,%.6f,%.6f,", l.time_s, l.force_mn, l.true_depth_mm, l.tool.depth_mm,
                         std::sqrt(l.tool.covariance[0][0]));
            for (const double* v : {l.true_tip_mm, l.tool.tip_mm, l.paper.tip_mm, l.joints_mm})
                std::fprintf(file, "%.6f,%.6f,%.6f,", v[0], v[1], v[2]);
            std::fprintf(file, "%u,%.3f,%.3f\n", l.tool.status, l.took_us, l.late_us);
        }
        std::fclose(file);
    }
    return 0;
}
