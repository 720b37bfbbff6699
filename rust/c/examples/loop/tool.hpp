// A simulated flexible tool: what its robot, its sclera and its fibres would do. Shares no code with sherkit.
#pragma once

#include <array>
#include <cmath>
#include <random>

namespace simulated {

using Vector = std::array<double, 3>;

// One moment of the tool. Its shaft points along the base frame's -z.
struct Moment {
    double depth_mm;
    std::array<double, 2> force_mn;  // tool frame
    Vector unbent_mm;                // base frame, where the unbent tip would be
    Vector tip_mm;                   // where the tip really is
    std::array<double, 9> wavelengths_nm;
};

class Tool {
public:
    // Rows of K_I and K_II, mN mm/nm; sections from the tip, mm.
    static constexpr double gain = 8000.0;
    static constexpr double distances_mm[2] = {28.0, 34.0};
    static constexpr double reference_nm = 1550.0;
    static constexpr double noise_nm = 2e-4;
    static constexpr double length_mm = 60.0;
    static constexpr double stiffness = 3.39e6 / 3.0;
    // The tool's axes in the base frame, as columns: x, -y, -z.
    static constexpr double rotation[3][3] = {{1, 0, 0}, {0, -1, 0}, {0, 0, -1}};

    // Depth at time zero, mm.
    static constexpr double first_depth_mm = 8.0;

    // The unbent tip goes in and out along the shaft, and around.
    static Vector unbent(double t)
    {
        const double in = 4.0 * std::sin(0.8 * t);
        return {2.0 * std::sin(1.3 * t), 2.0 * std::cos(0.9 * t), -in};
    }

    Moment at(double t)
    {
        Moment m{};
        const Vector now = unbent(t);
        m.unbent_mm = now;
        m.depth_mm = first_depth_mm - now[2];
        // contact that comes and goes
        const double size = 120.0 * std::fmax(0.0, std::sin(0.7 * t));
        m.force_mn = {size * std::cos(0.3 * t), size * std::sin(0.3 * t)};
        const double a = length_mm - m.depth_mm;
        const double bend = a * a * a / (3 * stiffness) + a * a * m.depth_mm / (2 * stiffness);
        // the sclera pushes the shaft, and the tip goes with it
        m.tip_mm = {now[0] + m.force_mn[0] * bend, now[1] - m.force_mn[1] * bend, now[2]};
        const double warm = 0.05 * std::sin(0.1 * t);
        for (int section = 0; section < 3; ++section) {
            const double lever = section < 2 ? distances_mm[section] - m.depth_mm : 0.0;
            // three fibres, 120 degrees apart
            for (int fibre = 0; fibre < 3; ++fibre) {
                const double angle = 2.0 * M_PI / 3.0 * fibre;
                const double strain = std::cos(angle) * m.force_mn[0] + std::sin(angle) * m.force_mn[1];
                m.wavelengths_nm[3 * section + fibre] =
                    reference_nm + warm + 2.0 / 3.0 * strain * lever / gain + noise_nm * normal_(random_);
            }
        }
        return m;
    }

private:
    std::mt19937_64 random_{1};
    std::normal_distribution<double> normal_;
};

}  // namespace simulated
