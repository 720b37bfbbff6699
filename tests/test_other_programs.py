"""Runs that other programs took: documents of bluesky, bags of ROS."""

from __future__ import annotations

import json

import numpy as np
import pytest

import sherkit as sk
from sherkit.cli import main
from sherkit.errors import MeasurementError, SherkitWarning

JOINTS = np.array([[130.0, 129.0, 131.0], [128.0, 130.5, 129.5], [131.0, 131.0, 130.0]])
PLACES_UM = np.array([[1000.0, 2000.0, -500.0], [0.0, -250.0, 125.0], [1.0, 2.0, 3.0]])
KEYS = {f"rails_q{k}": "mm" for k in (1, 2, 3)} | {f"laser_out{k}": "um" for k in (1, 2, 3)}
COLUMNS = {f"q{k}_mm": f"rails_q{k}" for k in (1, 2, 3)} | {
    f"{axis}_mm": f"laser_out{k}" for k, axis in enumerate("xyz", 1)
}


def told(paged=False):
    """The documents of a run, written by hand from bluesky's schemas."""
    described = {key: {"dtype": "number", "shape": [], "source": "x", "units": unit} for key, unit in KEYS.items()}
    described["comment"] = {"dtype": "string", "shape": [], "source": "x"}
    rows = [dict(zip(KEYS, (*q, *p), strict=True)) | {"comment": "a"} for q, p in zip(JOINTS, PLACES_UM, strict=True)]
    yield "start", {"uid": "run", "time": 100.0}
    yield "descriptor", {"uid": "other", "name": "baseline", "data_keys": {}, "run_start": "run", "time": 100.0}
    yield "descriptor", {"uid": "d", "name": "primary", "data_keys": described, "run_start": "run", "time": 100.0}
    if paged:
        data = {key: [row[key] for row in rows] for key in rows[0]}
        yield "event_page", {"descriptor": "d", "time": [101.0, 102.0, 104.0], "seq_num": [1, 2, 3], "data": data}
    else:
        for k, row in enumerate(rows):
            yield "event", {"descriptor": "d", "time": (101.0, 102.0, 104.0)[k], "seq_num": k + 1, "data": row}
    yield "stop", {"run_start": "run", "exit_status": "success", "time": 105.0}


@pytest.mark.parametrize("way", ["pairs", "pages", "file"])
def test_documents_are_a_run(tmp_path, way):
    """Catches a unit that is dropped, events of another stream, and times that count from 1970."""
    documents = told(way == "pages")
    if way == "file":
        documents = tmp_path / "run.jsonl"
        documents.write_text("\n".join(json.dumps(one) for one in told()), encoding="utf-8")
    with pytest.warns(SherkitWarning, match="converted from the units"):
        run = sk.from_bluesky(documents, columns=COLUMNS)
    np.testing.assert_allclose(run.joints, JOINTS)
    np.testing.assert_allclose(run.readings[:, :3], 1e-3 * PLACES_UM)
    np.testing.assert_allclose(run.time_s, [1.0, 2.0, 4.0])


@pytest.mark.parametrize(
    ("documents", "more", "said"),
    [
        (lambda: told(), {"columns": {"q1_mm": "rails_q9"}}, "no key 'rails_q9'.*'rails_q"),
        (lambda: told(), {"columns": {**COLUMNS, "z_mm": "comment"}}, "'comment' does not hold a number"),
        (lambda: told(), {"stream": "baseline"}, "no event of the stream 'baseline'; streams are baseline, primary"),
        (lambda: [*told(), *told()], {}, "holds 2 runs"),
        (lambda: [("start", {})], {}, "lacks or garbles 'time'"),
        (
            lambda: [(n, d | {"data_keys": {"rails_q1": 2.0}} if n == "descriptor" else d) for n, d in told()],
            {},
            "'descriptor' lacks or garbles",
        ),
        (lambda: [("start", {"time": 10**400})], {}, "'start' lacks or garbles"),
        (
            lambda: [(n, {**d, "name": {"x": 1}} if n == "descriptor" else d) for n, d in told()],
            {},
            "no event of the stream 'primary'",
        ),
        (lambda: [("event",)], {}, "document 1 is no pair"),
        (lambda: 5, {}, "got int"),
    ],
)
def test_documents_that_are_none_are_a_sentence(documents, more, said):
    """Catches a traceback of a broken document, and a key that is guessed."""
    with pytest.raises(MeasurementError, match=said):
        sk.from_bluesky(documents(), **more)


def test_what_bluesky_itself_gives_is_read():
    """Catches documents that bluesky writes otherwise than the test above believes."""
    bluesky = pytest.importorskip("bluesky")
    from bluesky import plans

    from sherkit.lab.emulators import GalilEmulator, KeyenceEmulator, World
    from sherkit.lab.instruments import Axis, Galil, Keyence
    from sherkit.lab.instruments.devices import GalilAxes, KeyenceDetector

    documents: list[tuple[str, dict]] = []
    axes = [Axis(x, 10000.0, (60.0, 200.0), name=f"q{k}") for k, x in enumerate("ABC", 1)]
    engine = bluesky.RunEngine({}, call_returns_result=False)
    world = World((130.0, 130.0, 130.0), time_scale=200.0)
    try:
        with (
            GalilEmulator(world) as rails, KeyenceEmulator(world) as lasers,
            Galil(rails.address, axes, poll_s=0.01, timeout_s=20.0, poll_timeout_s=20.0) as g,
            Keyence(lasers.address, timeout_s=20.0) as k,
        ):  # fmt: skip
            places = [tuple(float(q) for q in row) for row in JOINTS]
            plan = plans.list_scan([KeyenceDetector(k, "laser")], GalilAxes(g, "rails"), places)
            engine(plan, lambda name, document: documents.append((name, document)))
        run = sk.from_bluesky(documents, columns=COLUMNS)
    finally:
        engine.loop.call_soon_threadsafe(engine.loop.stop)
    np.testing.assert_allclose(run.joints, JOINTS, atol=1e-3)
    # on this bench each laser sees its joint
    np.testing.assert_allclose(run.readings[:, :3], JOINTS, atol=1e-3)


def typed(capsys, *arguments):
    """Exit code of the command, and what it printed on both sides."""
    with pytest.raises(SystemExit) as ended:
        main([str(one) for one in arguments])
    return ended.value.code, "".join(capsys.readouterr())


@pytest.mark.filterwarnings("always::sherkit.SherkitWarning")
def test_the_command_makes_a_run_of_documents(tmp_path, capsys):
    """Catches a verb that drops a column, a stream or the time, and one that numbers poses unasked."""
    documents, made = tmp_path / "documents.jsonl", tmp_path / "run.csv"
    documents.write_text("\n".join(json.dumps(one) for one in told()), encoding="utf-8")
    columns = [word for ours, key in COLUMNS.items() for word in ("--column", f"{ours}={key}")]
    code, said = typed(capsys, "import", "bluesky", documents, *columns, "-o", made)
    assert code == 0, said
    assert f"{made}: 3 rows of q1_mm, q2_mm, q3_mm, x_mm, y_mm, z_mm" in said
    run = sk.read_measurements(made)
    np.testing.assert_allclose(run.readings[:, :3], 1e-3 * PLACES_UM)
    np.testing.assert_allclose(run.time_s, [1.0, 2.0, 4.0])
    assert run.pose is None
    assert typed(capsys, "import", "bluesky", documents, *columns, "--each-a-pose", "-o", made)[0] == 0
    assert sk.read_measurements(made).pose.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--column", "q1_mm"], "--column q1_mm: expected a column and its name there, as q1_mm=rails_q1"),
        (["--column", "q1_mm=a", "--column", "q1_mm=b"], "--column q1_mm=b: 'q1_mm' is given twice"),
        (["--column", "q1_mm=rails_q9"], "no key 'rails_q9'"),
        (["--stream", "baseline"], "no event of the stream 'baseline'"),
    ],
)
def test_what_is_typed_wrong_of_documents_is_a_sentence(more, said, tmp_path, capsys):
    """Catches a traceback, or a file that is written all the same."""
    documents, made = tmp_path / "documents.jsonl", tmp_path / "run.csv"
    documents.write_text("\n".join(json.dumps(one) for one in told()), encoding="utf-8")
    code, printed = typed(capsys, "import", "bluesky", documents, *more, "-o", made)
    assert code == 1
    assert said in printed
    assert printed.count("\n") == 1
    assert not made.exists()


# -- ROS -------------------------------------------------------------------------------------------------------

RAILS = ("rail_1", "rail_2", "rail_3")
OURS = {f"q{k}_mm": name for k, name in enumerate(RAILS, 1)}
STEP_S = 0.02


def bag(folder, *, kind="geometry_msgs/msg/PoseStamped", gap=False):
    """A bag of three rails that slide evenly, seen at every third of their messages and a bit later. Returns times,
    joints and places as they were, s and mm."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    made = store.types

    def header(time_s):
        nanoseconds = round(time_s * 1e9)
        stamp = made["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return made["std_msgs/msg/Header"](stamp=stamp, frame_id="base")

    def joints_mm(time_s):
        return np.array([130.0 + 5.0 * time_s, 129.0 - 15.0 * time_s, 131.0])

    true = []
    with rosbag2.Writer(folder, version=9) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        seen = writer.add_connection("/tracker", kind, typestore=store)
        for n in range(60):
            time_s = n * STEP_S
            if not (gap and 20 < n < 30):
                q = 1e-3 * joints_mm(time_s)
                message = made["sensor_msgs/msg/JointState"](
                    header=header(100 + time_s), name=list(RAILS[::-1]), position=q[::-1].copy(),
                    velocity=np.zeros(3), effort=np.zeros(3),
                )  # fmt: skip
                writer.write(joints, n, store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
            if n % 3 == 1:
                at = time_s + 0.4 * STEP_S
                place = np.array([0.1 + 0.01 * n, 0.2, 0.3])
                true.append((at, joints_mm(at), 1e3 * place))
                point = made["geometry_msgs/msg/Point"](*map(float, place))
                turn = made["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
                pose = made["geometry_msgs/msg/Pose"](position=point, orientation=turn)
                whole = {
                    "geometry_msgs/msg/PoseStamped": {"pose": pose},
                    "geometry_msgs/msg/PointStamped": {"point": point},
                }
                message = made[kind](header=header(100 + at), **whole[kind])
                # it is written late, as a slow tracker's: the header counts
                writer.write(seen, n + 7, store.serialize_cdr(message, kind))
    return true


def test_a_bag_whose_pages_are_damaged_is_a_sentence(tmp_path):
    """Catches a database that is read on from a damaged page: for minutes, or until memory ended."""
    bag(tmp_path / "bag")
    database = next((tmp_path / "bag").glob("*.db3"))
    assert len(sk.from_rosbag(tmp_path / "bag", OURS, "/tracker"))
    raw = bytearray(database.read_bytes())
    page = int.from_bytes(raw[16:18], "big")
    # a leaf of the table of messages, whose first row is said to be far longer than the file
    leaf = next(at for at in range(page, len(raw), page) if raw[at] == 13 and raw[at + 3 : at + 5] > b"\x00\x02")
    row = leaf + int.from_bytes(raw[leaf + 8 : leaf + 10], "big")
    raw[row : row + 5] = b"\xff\xff\xff\xff\x7f"
    named = database.read_bytes().replace(b"ON messages (", b"ON messag\xeds (", 1)
    for damaged in (raw, named):
        database.write_bytes(damaged)
        with pytest.raises(MeasurementError, match=r"db3: is damaged \(.*record it anew"):
            sk.from_rosbag(tmp_path / "bag", OURS, "/tracker")


@pytest.mark.parametrize("kind", ["geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"])
def test_a_bag_is_a_run(tmp_path, kind):
    """Catches metres read as mm, joints by their place in the message, and joints at the time of writing."""
    true = bag(tmp_path / "bag", kind=kind)
    run = sk.from_rosbag(tmp_path / "bag", OURS, "/tracker", coordinates=("x_mm", "y_mm", "z_mm"))
    assert len(run) == len(true)
    np.testing.assert_allclose(run.joints, [q for _, q, _ in true], atol=1e-8)
    np.testing.assert_allclose(run.readings[:, :3], [p for _, _, p in true])
    with pytest.raises(MeasurementError, match=r"no joint 'rial_1'.*rail_1"):
        sk.from_rosbag(tmp_path / "bag", {"q1_mm": "rial_1"}, "/tracker")
    with pytest.raises(MeasurementError, match=r"no topic '/trakcer'.*/tracker"):
        sk.from_rosbag(tmp_path / "bag", OURS, "/trakcer")
    with pytest.raises(MeasurementError, match="no such bag"):
        sk.from_rosbag(tmp_path / "nothing", OURS, "/tracker")
    (tmp_path / "torn").mkdir()
    with pytest.raises(MeasurementError, match="no bag that can be read"):
        sk.from_rosbag(tmp_path / "torn", OURS, "/tracker")


def test_the_command_makes_a_run_of_a_bag(tmp_path, capsys):
    """Catches a verb that drops a joint, a topic or an option, and bad input that is more than a sentence."""
    true = bag(tmp_path / "bag")
    made = tmp_path / "run.parquet"
    joints = [word for ours, name in OURS.items() for word in ("--joint", f"{ours}={name}")]
    line = ("import", "rosbag", tmp_path / "bag", *joints, "-o", made)
    code, said = typed(capsys, *line, "--poses", "/tracker")
    assert code == 0, said
    run = sk.read_measurements(made)
    np.testing.assert_allclose(run.joints, [q for _, q, _ in true], atol=1e-8)
    np.testing.assert_allclose(run.readings[:, :3], [p for _, _, p in true])
    np.testing.assert_allclose(np.diff(run.time_s), np.diff([at for at, _, _ in true]), atol=1e-6)
    made.unlink()
    for more, wrong in (
        (["--poses", "/trakcer"], "no topic '/trakcer'"),
        (["--poses", "/tracker", "--joint-states", "/joints"], "no topic '/joints'"),
        (["--poses", "/tracker", "--coordinates", "x_rad,y_rad,z_rad"], "cannot be read from a number in m"),
        (["--poses", "/tracker", "--joint", "q4_mm"], "--joint q4_mm: expected a column and its name there"),
    ):
        code, said = typed(capsys, *line, *more)
        assert code == 1
        assert wrong in said
        assert said.count("\n") == 1
        assert not made.exists()


def test_poses_that_no_joints_go_with_are_said(tmp_path):
    """Catches a pose that is given the joints of another time, and a row that is lost without a word."""
    true = bag(tmp_path / "bag", gap=True)
    lost = sum(20 * STEP_S < at < 30 * STEP_S for at, _, _ in true)
    with pytest.warns(SherkitWarning, match=f"of {len(true)} poses were left out: {lost} without joint states"):
        run = sk.from_rosbag(tmp_path / "bag", OURS, "/tracker")
    assert len(run) == len(true) - lost > 0
    with pytest.raises(MeasurementError, match="no pose"), pytest.warns(SherkitWarning, match="while a joint moved"):
        sk.from_rosbag(tmp_path / "bag", OURS, "/tracker", still_per_s=10.0)
