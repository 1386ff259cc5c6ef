"""The figures of the paper's tables 1 to 9, to stand beside ours."""

from __future__ import annotations

from typing import NamedTuple

# BM in degrees per frame, AFS in cm per frame, SSIM, MPJPE in cm; "" where the table has none. On the paper's own data.
Row = tuple[float | str, float | str, float | str, float | str]


class StudyRow(NamedTuple):
    """Mean and deviation of a model's scores; t and one-sided p of TPTN against it, but for TPTN itself."""

    mean: float
    std: float
    t: float | None = None
    p: float | None = None


ALL_TESTS: dict[str, Row] = {  # table 1: test motions with dances
    "recorded": (82.740, 0.208, 1.0, 0.0),
    "MVAE": (101.353, 0.534, 0.977, 2.905),
    "HTSS": (137.601, 0.529, 0.979, 1.771),
    "TPTN": (78.401, 0.331, 0.985, 1.906),
}
NON_DANCE: dict[str, Row] = {  # table 2
    "recorded": (95.752, 0.234, 1.0, 0.0),
    "MVAE": (86.477, 0.480, 0.985, 3.809),
    "HTSS": (134.040, 0.363, 0.990, 1.831),
    "NeuralLayering": (112.072, 0.351, 0.994, 2.185),
    "TPTN": (89.274, 0.302, 0.992, 1.885),
}
PFNN_DATA: dict[str, Row] = {  # table 3
    "recorded": (70.060, 0.184, 1.0, 0.0),
    "PFNN": (82.136, 0.354, 0.977, 4.484),
    "TPTN": (67.473, 0.215, 0.986, 7.318),
}
D_L: dict[str, Row] = {  # tables 6 to 9, on the small data set
    "recorded": (88.975, 0.269, 1.0, ""),
    "TPTN": (82.162, 0.340, 0.991, ""),
    "EBTN": (79.207, 0.348, 0.991, ""),
    "FPTN-R": (78.350, 0.323, 0.990, ""),
    "FPTN-S": (80.408, 0.342, 0.989, ""),
    "5PTN": (79.672, 0.363, 0.991, ""),
    "w/o-FFL": (79.107, 0.345, 0.991, ""),
    "CrossAttn": (76.955, 0.384, 0.990, ""),
    "w/o-CL": (78.124, 0.330, 0.990, ""),
    "TRL39": (81.952, 0.361, 0.990, ""),
    "TRL135": (77.476, 0.345, 0.991, ""),
    "TP-NLNN": (81.467, 0.732, 0.983, ""),
    "TP-LSTM4LR": (106.122, 0.541, 0.979, ""),
    "w/o-FK": (79.075, 0.342, 0.991, ""),
    "w/o-OS": (80.826, 0.343, 0.990, ""),
    "w/o-C": (80.426, 0.348, 0.990, ""),
    "L2 Loss": (55.328, 0.434, 0.991, ""),
    "w/o-F": (89.086, 0.551, 0.989, ""),
}
# The user study: tables 4 (motions without dances, 11 groups) and 5 (all test motions, 13 groups, two of them dances).
STUDIES = {
    "4": {
        "TPTN": StudyRow(3.922, 0.416),
        "MVAE": StudyRow(2.390, 0.507, 7.747, 9.539e-8),
        "HTSS": StudyRow(2.448, 0.403, 8.443, 2.508e-8),
        "NeuralLayering": StudyRow(3.545, 0.532, 1.850, 3.757e-2),
    },
    "5": {
        "TPTN": StudyRow(3.907, 0.407),
        "MVAE": StudyRow(2.709, 0.592, 6.017, 1.634e-6),
        "HTSS": StudyRow(2.549, 0.427, 8.300, 8.180e-9),
    },
}
# BM of upper and lower body (section 5.5, "Feature fusion layer and consistency loss").
BODY_MOVEMENT = {"recorded": (64.692, 43.645), "TPTN": (59.084, 38.165), "w/o-CL": (55.274, 37.234)}
BY_DATA_SET = {
    "D_L": D_L,
    "all": ALL_TESTS,
    "all-mirrored": ALL_TESTS,
    "no-dances": NON_DANCE,
    "locomotion": PFNN_DATA,
}
