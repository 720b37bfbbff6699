"""Its verbs, in their places in the help; each is loaded when it is called."""

from ...cli.groups import Later

PLAN = Later(
    "sherkit.lab.verbs.plan:plan",
    "Measure",
    "what an experiment could find, before it is driven",
    "sherkit plan robot.toml experiment.toml --noise-um 2",
    "sherkit plan calibrated.toml --verify --poses 20",
    at=1,
)
HOME = Later(
    "sherkit.lab.verbs.measure:home",
    "Measure",
    "set the zero of axes",
    "sherkit home experiment.toml",
    "sherkit home experiment.toml --at 128.9,128.9,128.9",
    at=2,
)
MEASURE = Later(
    "sherkit.lab.verbs.measure:measure",
    "Measure",
    "drive to each pose, read the instruments",
    "sherkit measure experiment.toml --live",
    "sherkit measure experiment.toml --until diagnosed",
    "sherkit measure experiment.toml --python my_lab.py --resume",
    at=3,
)
LAB = Later(
    "sherkit.lab.verbs.lab:lab",
    "Measure",
    "emulated instruments of a laboratory",
    "sherkit lab --demo",
    "sherkit lab lab.toml --ports ports.json",
    at=4,
)
