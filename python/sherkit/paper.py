"""What Xiao et al., ISMR 2022, printed, to stand beside one's own figures."""

from __future__ import annotations

#: Table I: RMS ± standard deviation, µm, per axis.
TABLE_I = {
    "whole": {
        "before": {"x": (1388, 1390), "y": (1293, 1297), "z": (650, 459)},
        "after": {"x": (245, 217), "y": (149, 144), "z": (217, 149)},
        "before, region": {"x": (798, 780), "y": (769, 771), "z": (175, 149)},
        "after, region": {"x": (140, 74), "y": (77, 66), "z": (116, 34)},
    },
    "local": {
        "before": {"x": (762, 764), "y": (771, 773), "z": (222, 169)},
        "after": {"x": (121, 68), "y": (97, 57), "z": (100, 27)},
    },
}

#: Table II: identified errors per limb: δr_b mm, δθ_b deg, δL mm, δl mm.
TABLE_II = {
    "whole": ((-2.31, 0.38, -0.43, 1.23), (5.19, 0.21, -1.79, 3.49), (2.83, -1.32, 0.68, 0.44)),
    "local": ((1.33, 0.12, 1.31, -0.70), (3.76, 0.15, 1.28, 0.28), (2.57, -1.83, 1.60, -0.49)),
}

#: Table III: order, RMS ± standard deviation on the test set, on the upper and on the lower plane, µm.
TABLE_III = {
    "whole": {"x": (6, (40, 38), (121, 80), (82, 75)), "y": (6, (27, 28), (36, 35), (90, 49)),
              "z": (6, (31, 31), (77, 76), (27, 25))},
    "local": {"x": (3, (11, 10), (18, 18), (18, 18)), "y": (3, (9, 9), (15, 15), (16, 16)),
              "z": (3, (13, 12), (18, 15), (13, 13))},
}  # fmt: skip

#: Repeatability, ± µm, per axis.
REPEATABILITY = {"whole": (19.1, 14.9, 14.5), "local": (3.7, 5.4, 4.1)}

#: Accuracy that subretinal injection needs, µm.
REQUIREMENT_UM = 20.0
