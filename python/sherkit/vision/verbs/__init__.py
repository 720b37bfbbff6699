"""Its verbs, in their places in the help; each is loaded when it is called."""

from ...cli.groups import Later

MARKERS = Later(
    "sherkit.vision.verbs.cameras:markers",
    "Import, cameras, C",
    "where a marker is in pictures",
    "sherkit markers --print marker.pdf",
    "sherkit markers pictures/ --joints joints.csv -o run.csv",
    at=2,
)
INTRINSICS = Later(
    "sherkit.vision.verbs.cameras:intrinsics",
    "Import, cameras, C",
    "focal lengths, centre, distortion of a camera",
    "sherkit intrinsics boards/ --chessboard 9x6 --square-mm 10 -o camera.toml",
    at=3,
)
