"""Vision: a marker in rendered pictures, intrinsics from boards, rows joined by time."""

from __future__ import annotations

import re
import shutil
import tomllib
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import tomli_w
from click.testing import CliRunner
from numpy.typing import NDArray

from running import slow
from sherkit import identify, load_robot, read_measurements
from sherkit.cli.verbs import cli
from sherkit.errors import MeasurementError, SherkitError, SherkitWarning
from sherkit.robots.spherical import Spherical, VirtualSpherical, sphere_patch
from sherkit.robots.spherical.virtual import PAPER_ERRORS

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: sherkit[vision]")

from sherkit.vision.camera import Intrinsics, View, charuco_intrinsics, chessboard_intrinsics, draw_marker  # noqa: E402
from sherkit.vision.marker import SeenMarker, find_marker  # noqa: E402
from sherkit.vision.pictures import CameraPicture, frames_of, picture_of  # noqa: E402
from sherkit.vision.spherical import joined_by_time, marker_rows, pictures_of, seen_run  # noqa: E402

CAMERA = Intrinsics((1100.0, 1080.0), (645.0, 318.0), (-0.12, 0.05, 0.001, -0.0008), (1280, 640))
VIEW = View(CAMERA, (0.02, -0.03, 0.1), (5.0, -4.0, 446.2))


def seen_at(point: NDArray[np.float64], view: View = VIEW) -> NDArray[np.float64]:
    """Where the camera sees a point, from the formula of Brown and Conrady written out: the second way."""
    x, y, z = view.rotation @ point + np.array(view.translation_mm)
    x, y = x / z, y / z
    k1, k2, p1, p2 = view.intrinsics.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    (fx, fy), (cx, cy) = view.intrinsics.focal_px, view.intrinsics.centre_px
    return np.array([fx * xd + cx, fy * yd + cy])


def places(count: int, seed: int) -> list[NDArray[np.float64]]:
    """Points on the camera's side of a sphere of 200 mm, inside the picture."""
    rng = np.random.default_rng(seed)
    out: list[NDArray[np.float64]] = []
    while len(out) < count:
        n = np.array([*rng.uniform(-0.6, 0.6, 2), -1.0])
        point = 200.0 * n / np.linalg.norm(n)
        u, v = seen_at(point)
        if 40 < u < 1240 and 40 < v < 600:
            out.append(point)
    return out


def test_a_marker_is_found_to_hundredths_of_a_pixel() -> None:
    """Catches a detector that is biased by half a pixel, by slant or by turn, and a deviation that is made up."""
    rng = np.random.default_rng(3)
    off = []
    for point in places(30, 1):
        picture = draw_marker(VIEW, point, point, 6.0, rng, turn_rad=rng.uniform(0, np.pi))
        seen = find_marker(picture)
        assert seen.found, seen.why
        off.append(np.array([seen.u_px, seen.v_px, 0.0, 0.0]) - [*seen_at(point), 0, 0])
        off[-1][2:] = off[-1][:2] / seen.sigma_px
    off = np.array(off)
    assert np.abs(off[:, :2]).max() < 0.12
    assert off[:, :2].std() < 0.02
    # bias: the mean of 30 within four of its standard errors
    assert (np.abs(off[:, :2].mean(axis=0)) < 4 * off[:, :2].std(axis=0) / np.sqrt(len(off))).all()
    assert 0.5 < np.sqrt(np.mean(off[:, 2:] ** 2)) < 2.0


def test_what_is_no_marker_says_so() -> None:
    """Catches a place made up where there is none: an empty picture, a chessboard, a blurred or a doubled marker."""
    rng = np.random.default_rng(0)
    point = places(1, 2)[0]
    sharp = draw_marker(VIEW, point, point, 6.0, rng)
    for blur in (3.0, 4.5):
        seen = find_marker(draw_marker(VIEW, point, point, 6.0, rng, blur_px=blur))
        assert not seen.found
        assert "blurred" in seen.why
        assert np.isnan(seen.u_px)
    for empty in (np.full((640, 1280), 128, np.uint8), rng.integers(100, 150, (640, 1280)).astype(np.uint8)):
        assert "no marker" in find_marker(empty).why
    other = draw_marker(VIEW, -point * [1, 1, -1], point * [-1, -1, 1], 6.0, rng)
    both = np.where(np.abs(other.astype(int) - 128) > 30, other, sharp).astype(np.uint8)
    assert find_marker(both).why.startswith("2 candidates")
    disk = cv2.circle(np.full((640, 1280), 128, np.uint8), (500, 300), 30, 20, -1)
    assert not find_marker(disk).found
    board = chessboard((9, 6), 40)
    assert "candidates" in find_marker(board).why


@pytest.mark.parametrize("kind", ["aruco", "apriltag"])
def test_a_tag_is_found_in_its_middle(kind: str) -> None:
    """Catches the mean of four corners taken for the middle of a tag seen at a slant, and the wrong one of two tags."""
    from sherkit.vision.marker import DICTIONARIES

    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[kind][1])

    def at(number: int, left: float) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        tag = cv2.copyMakeBorder(cv2.aruco.generateImageMarker(dictionary, number, 200), 40, 40, 40, 40, 0, value=255)
        corners = np.array([[left, 100], [left + 180, 130], [left + 150, 320], [left - 20, 280]], np.float32)
        source = np.array([[0, 0], [280, 0], [280, 280], [0, 280]], np.float32)
        h = cv2.getPerspectiveTransform(source, corners)
        picture = cv2.warpPerspective(tag, h, (1280, 640), borderValue=128, flags=cv2.INTER_AREA)
        middle = h @ [139.5, 139.5, 1.0]
        return cv2.GaussianBlur(picture, (0, 0), 0.8), middle[:2] / middle[2]

    picture, middle = at(3, 300.0)
    seen = find_marker(picture, kind)
    assert seen.found, seen.why
    assert np.hypot(seen.u_px - middle[0], seen.v_px - middle[1]) < 0.3
    second, _ = at(7, 800.0)
    both = np.where(np.abs(second.astype(int) - 128) > 20, second, picture).astype(np.uint8)
    assert "2 candidates" in find_marker(both, kind).why
    assert np.hypot(find_marker(both, kind, 3).u_px - middle[0], 0) < 0.3
    assert "no" in find_marker(both, kind, 11).why


def chessboard(corners: tuple[int, int], square: int) -> NDArray[np.uint8]:
    """A flat chessboard with a white rim."""
    columns, rows = corners[0] + 1, corners[1] + 1
    fields = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 * 235 + 10).astype(np.uint8)
    return cv2.copyMakeBorder(np.kron(fields, np.ones((square, square), np.uint8)), 60, 60, 60, 60, 0, value=250)


def photographed(board: NDArray[np.uint8], count: int, seed: int) -> list[NDArray[np.uint8]]:
    """A board in several poses through the distorted camera: each pixel's ray is followed to the board's plane."""
    rng = np.random.default_rng(seed)
    width, height = CAMERA.size_px
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(float)
    rays = cv2.undistortPoints(
        grid, CAMERA.matrix, np.array(CAMERA.distortion),
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-12),
    ).reshape(-1, 2)  # fmt: skip
    rays = np.column_stack([rays, np.ones(len(rays))])
    out = []
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        per_mm = 2.0  # pixels of the board per mm
        middle = np.array([board.shape[1], board.shape[0]]) / per_mm / 2
        shift = np.array([*rng.uniform(-15, 15, 2), rng.uniform(340, 440)])
        normal = rotation[:, 2]
        hit = rays * ((shift @ normal) / (rays @ normal))[:, None] - shift
        place = (hit @ rotation[:, :2] + middle) * per_mm - 0.5
        sharp = cv2.remap(
            board, place[:, 0].reshape(height, width).astype(np.float32),
            place[:, 1].reshape(height, width).astype(np.float32), cv2.INTER_LINEAR, borderValue=128,
        )  # fmt: skip
        noisy = cv2.GaussianBlur(sharp, (0, 0), 0.8) + rng.normal(0, 1.5, sharp.shape)
        out.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return out


@pytest.mark.parametrize("board", [*slow("chessboard"), "charuco"])
def test_intrinsics_come_back(board: str) -> None:
    """Catches swapped axes, a wrong size of squares, a deviation that is none: values within four of them."""
    if board == "chessboard":
        found = chessboard_intrinsics(photographed(chessboard((9, 6), 40), 12, 5), (9, 6), 20.0)
    else:
        made = cv2.aruco.CharucoBoard((9, 6), 20.0, 15.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
        found = charuco_intrinsics(photographed(made.generateImage((440, 320), None, 40, 1), 12, 6), (9, 6), 20.0, 15.0)
    assert found.pictures == 12
    assert found.without == {}
    assert found.rms_px < 0.3
    values = np.array([*found.focal_px, *found.centre_px, *found.distortion])
    true = np.array([*CAMERA.focal_px, *CAMERA.centre_px, *CAMERA.distortion])
    # corner finding is not white noise: twice what OpenCV's own deviations allow
    assert (np.abs(values - true) < 8 * np.array(found.std) + 1e-4).all(), (values - true) / np.array(found.std)


def test_bad_pictures_are_named(tmp_path: Path) -> None:
    """Catches a picture that is left out in silence, and a reader who cannot tell which one is bad."""
    boards = photographed(chessboard((9, 6), 40), 4, 5)
    empty = np.full((640, 1280), 128, np.uint8)
    with pytest.raises(SherkitError, match=r"was found in 3 pictures; .* picture 1"):
        chessboard_intrinsics([boards[0], empty, *boards[1:3]], (9, 6), 20.0)
    with pytest.raises(SherkitError, match="picture 1: is 100 × 90 px"):
        chessboard_intrinsics([boards[0], empty[:90, :100]], (9, 6), 20.0)
    with pytest.raises(SherkitError, match="there is no such picture"):
        chessboard_intrinsics([tmp_path / "none.png"], (9, 6), 20.0)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(SherkitError, match="is not a picture"):
        picture_of(tmp_path / "text.png")
    with pytest.raises(SherkitError, match="expected grey values"):
        picture_of(np.zeros((4, 4)))
    with pytest.raises(SherkitError, match="choose corner, aruco, apriltag"):
        find_marker(empty, "cross")


def test_a_video_gives_a_row_for_every_picture(tmp_path: Path) -> None:
    """Catches lost pictures and times that are counted from 1 or in milliseconds: the empty picture keeps its row."""
    rng = np.random.default_rng(1)
    points = places(5, 9)
    path = tmp_path / "run.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, CAMERA.size_px, isColor=False)
    for k, point in enumerate(points):
        picture = draw_marker(VIEW, point, point, 6.0, rng)
        writer.write(np.full_like(picture, 128) if k == 2 else picture)
    writer.release()
    rows = marker_rows(frames_of(path))
    assert rows["time_s"].to_list() == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08], abs=1e-9)
    assert rows["u_px"].is_null().to_list() == [False, False, True, False, False]
    assert rows["why"].to_list()[2].startswith("no marker")
    for k in (0, 1, 3, 4):
        u, v = seen_at(points[k])
        # lossy pictures
        assert np.hypot(rows["u_px"][k] - u, rows["v_px"][k] - v) < 0.5
    with pytest.raises(SherkitError, match="there is no such video"):
        next(iter(frames_of(tmp_path / "none.avi")))


def test_camera_and_joints_are_joined_by_time() -> None:
    """Catches the nearest reading taken instead of the one at that moment, a delay of the wrong sign, extrapolation."""
    t = np.arange(0, 1.0, 0.005)
    joints = pl.DataFrame({"time_s": t, "theta1_rad": 0.3 + 0.5 * t, "theta2_rad": np.sin(t)})
    camera = pl.DataFrame({"time_s": np.array([0.2012, 0.5, 0.9]), "u_px": [1.0, 2.0, 3.0]})
    names = ("theta1_rad", "theta2_rad")
    out = joined_by_time(camera, joints, names, delay_s=0.0333)
    moment = camera["time_s"].to_numpy() - 0.0333
    np.testing.assert_allclose(out["theta1_rad"], 0.3 + 0.5 * moment, atol=1e-12)
    np.testing.assert_allclose(out["theta2_rad"], np.sin(moment), atol=5e-6)
    np.testing.assert_allclose(out["theta1_rad_per_s"], 0.5, atol=1e-9)
    np.testing.assert_allclose(out["theta2_rad_per_s"], np.cos(moment), atol=3e-3)
    with pytest.raises(MeasurementError, match=r"row 2 at .* lies outside"):
        joined_by_time(camera, joints.head(150), names)
    with pytest.raises(MeasurementError, match="has no reading within"):
        joined_by_time(camera, joints[[0, 1, 198, 199]], names)
    with pytest.raises(MeasurementError, match="does not grow at row 3"):
        joined_by_time(camera, joints[[0, 1, 2, 1]], names)
    with pytest.raises(MeasurementError, match="'theta3_rad' is missing"):
        joined_by_time(camera, joints, ("theta3_rad",))


def test_a_row_that_lacks_a_marker_is_a_sentence() -> None:
    """Catches NaN that travels on: what is not found is empty in the table."""
    rows = marker_rows([CameraPicture(np.full((64, 64), 9, np.uint8), "dark", 1.5)])
    assert rows["u_px"].to_list() == [None]
    assert rows["time_s"].to_list() == [1.5]
    assert isinstance(find_marker(np.full((64, 64), 9, np.uint8)), SeenMarker)


# -- from the command line -----------------------------------------------------------------------------------------

DIAMOND = Path(__file__).parents[1] / "examples" / "diamond.toml"


def sherkit(*arguments: str | Path) -> Any:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a simulated run of 16 poses and its pictures."""
    folder = tmp_path_factory.mktemp("filmed")
    robot = load_robot(DIAMOND)
    assert isinstance(robot, Spherical)
    virtual = VirtualSpherical(robot, PAPER_ERRORS)
    plan = virtual.plan(sphere_patch(robot, 4), repeats=1)
    seen_run(plan, pictures_of(virtual, plan), save_in=folder / "pictures").save(folder / "run.csv")
    return folder


def test_pictures_become_the_run_that_was_simulated(filmed: Path, tmp_path: Path) -> None:
    """Catches pictures in another order than their joints, and a format that the reader does not take."""
    made = sherkit("markers", filmed / "pictures", "--joints", filmed / "run.csv", "-o", tmp_path / "again.csv")
    assert made.exit_code == 0, made.output
    assert (tmp_path / "again.csv").read_bytes() == (filmed / "run.csv").read_bytes()
    fit = identify(load_robot(DIAMOND), read_measurements(tmp_path / "again.csv"))
    planted = np.array([PAPER_ERRORS.get(name, 0.0) for name in fit.model.free])
    assert (np.abs(fit.values - planted) < 4.5 * fit.std).all()


def test_every_picture_has_a_row(filmed: Path, tmp_path: Path) -> None:
    """Catches a picture without a marker that vanishes, with joints or without them."""
    shutil.copytree(filmed / "pictures", tmp_path / "pictures")
    cv2.imwrite(str(tmp_path / "pictures" / "picture_0003.png"), np.full((640, 1280), 128, np.uint8))
    made = sherkit("markers", tmp_path / "pictures", "-o", tmp_path / "rows.csv")
    assert "16 rows written" in made.output
    assert "1 without a marker" in made.output
    rows = pl.read_csv(tmp_path / "rows.csv")
    assert rows["u_px"].is_null().to_list() == [k == 2 for k in range(16)]
    assert rows["why"][2] == "no marker was found"
    with pytest.warns(SherkitWarning, match=r"1 of 16 pictures give no row: .*picture_0003\.png: no marker"):
        made = sherkit("markers", tmp_path / "pictures", "--joints", filmed / "run.csv", "-o", tmp_path / "run.csv")
    assert made.exit_code == 0, made.output
    assert read_measurements(tmp_path / "run.csv").pose.tolist() == [k for k in range(1, 17) if k != 3]


def test_a_picture_that_cannot_be_read_stops_no_batch(filmed: Path, tmp_path: Path) -> None:
    """Catches a batch that ends at one broken file, a row that slips to the next picture's joints, and silence."""
    shutil.copytree(filmed / "pictures", tmp_path / "pictures")
    names = [f"picture_{k:04d}.png" for k in range(1, 17)]
    (tmp_path / "pictures" / names[6]).write_text("the disk was full")
    made = sherkit("markers", tmp_path / "pictures", "-o", tmp_path / "rows.csv")
    assert made.exit_code == 0, made.output
    assert f"{names[6]}: is not a picture that can be read" in " ".join(made.stderr.split())
    rows = pl.read_csv(tmp_path / "rows.csv")
    assert rows["why"].to_list() == ["is not a picture that can be read" if k == 6 else None for k in range(16)]
    with pytest.warns(SherkitWarning, match=rf"1 of 16 pictures give no row: .*{names[6]}: is not a picture"):
        made = sherkit("markers", tmp_path / "pictures", "--joints", filmed / "run.csv", "-o", tmp_path / "run.csv")
    assert made.exit_code == 0, made.output
    kept, whole = (read_measurements(path / "run.csv") for path in (tmp_path, filmed))
    assert kept.pose.tolist() == [k for k in range(1, 17) if k != 7]
    np.testing.assert_array_equal(kept.readings, np.delete(whole.readings, 6, axis=0))
    for name in names:
        (tmp_path / "pictures" / name).write_bytes(b"")
    refused = sherkit("markers", tmp_path / "pictures", "-o", tmp_path / "none.csv")
    assert str(refused.exception).endswith(
        f"{names[0]}: is not a picture that can be read; none of the 16 pictures can be read"
    )
    assert not (tmp_path / "none.csv").exists()


def on_paper(path: Path) -> tuple[NDArray[np.uint8], float]:
    """The picture of a printed marker, and how many of its pixels make a millimetre of paper."""
    data = path.read_bytes()
    if path.suffix == ".png":
        at = data.index(b"pHYs") + 4
        assert data[at + 8] == 1  # per metre
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), int.from_bytes(data[at : at + 4], "big") / 1e3
    side = int(re.search(rb"/Width (\d+)", data)[1])
    points = float(re.search(rb"q ([\d.]+) 0 0 ", data)[1])
    packed = data[data.index(b"stream\n", data.index(b"/Image")) + 7 :]
    bits = np.frombuffer(zlib.decompressobj().decompress(packed), np.uint8).reshape(side, -1)
    white = np.pad(np.unpackbits(bits, axis=1)[:, :side], side // 4, constant_values=1)
    assert data.startswith(b"%PDF-1.4")
    assert data[int(data.split(b"startxref\n")[1].split()[0]) :].startswith(b"xref")
    assert b"print at 100 %" in data
    return white * np.uint8(255), side / (points * 25.4 / 72)


@pytest.mark.parametrize("ending", ["png", "pdf"])
@pytest.mark.parametrize(("kind", "identity"), [("corner", None), ("aruco", 7), ("apriltag", 30)])
def test_the_printed_marker_is_the_one_that_is_looked_for(
    kind: str, identity: int | None, ending: str, tmp_path: Path
) -> None:
    """Catches a tag of another dictionary or number, a marker turned inside out, and a size that is not that of the
    paper; the size is measured on the black of the picture."""
    path = tmp_path / f"marker.{ending}"
    more = () if identity is None else ("--identity", str(identity))
    made = sherkit("markers", "--print", path, "--marker", kind, "--size-mm", "17.5", *more)
    assert made.exit_code == 0, made.output
    assert "17.5 mm" in made.output
    picture, per_mm = on_paper(path)
    # cut out, as the words below have corners too
    picture = picture[: round(30 * per_mm)]
    share = 8.0 / per_mm
    seen = find_marker(cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), kind, identity)
    assert seen.found, seen.why
    middle = round((seen.v_px + 0.5) / share), round((seen.u_px + 0.5) / share)
    rows, columns = np.nonzero(picture < 128)
    assert np.hypot(rows.mean() - middle[0], columns.mean() - middle[1]) < 3.0 * per_mm
    for black in (rows, columns):
        assert (np.ptp(black) + 1) / per_mm == pytest.approx(17.5, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--print", "marker.svg"), "marker.svg: expected a name that ends in .pdf or .png"),
        (("--print", "m.pdf", "--marker", "aruco", "--identity", "50"), "DICT_4X4_50 has the tags 0 to 49, got 50"),
        (("--print", "m.pdf", "--identity", "1"), "a corner marker has no number"),
        (("--print", "m.pdf", "--size-mm", "300"), "at most 180 mm"),
        (("--print", "m.pdf", "pictures"), "looks at no pictures"),
        ((), "expected SOURCES, the pictures to look at; or --print FILE"),
        (("pictures",), "expected -o, the table to write; or --print FILE"),
    ],
)
def test_what_cannot_be_printed_is_said(
    arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a file of another kind under the wrong name, and a tag that the dictionary does not have."""
    monkeypatch.chdir(tmp_path)
    refused = sherkit("markers", *arguments)
    assert refused.exit_code != 0
    assert says in " ".join(f"{refused.output} {refused.exception}".split())
    assert not list(tmp_path.iterdir())


def test_a_video_is_joined_to_joints_by_time(tmp_path: Path) -> None:
    """Catches a video joined by number, a delay with the wrong sign, and velocities that are lost on the way."""
    robot = load_robot(DIAMOND)
    assert isinstance(robot, Spherical)
    virtual = VirtualSpherical(robot)
    start, end = robot.inverse_batch([[1.3, 0.6], [1.8, 0.9]]).values
    times = np.arange(12) * 0.02
    way = start + np.outer(times / times[-1], end - start)
    columns = {"time_s": times, "theta1_rad": way[:, 0], "theta2_rad": way[:, 1]}
    writer = cv2.VideoWriter(
        str(tmp_path / "run.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, (1280, 640), isColor=False
    )
    for picture in pictures_of(virtual, columns):
        writer.write(picture.grey)
    writer.release()
    # the camera's clock stands 0.03 s later than that of the joints
    logged = np.arange(-10, 60) * 0.005
    log = start + np.outer((logged + 0.03) / times[-1], end - start)
    pl.DataFrame({"time_s": logged, "theta1_rad": log[:, 0], "theta2_rad": log[:, 1]}).write_csv(
        tmp_path / "joints.csv"
    )
    made = sherkit("markers", tmp_path / "run.avi", "--joints", tmp_path / "joints.csv", "--delay-s", "0.03", "-o",
                   tmp_path / "run.csv")  # fmt: skip
    assert made.exit_code == 0, made.output
    run = read_measurements(tmp_path / "run.csv")
    np.testing.assert_allclose(run.joints, way, atol=1e-6)
    speed = (end - start) / times[-1]
    np.testing.assert_allclose(run.covariates["theta2_rad_per_s"], speed[1], rtol=1e-6)
    # lossy pictures
    assert np.abs(run.readings - virtual.true_reading(way)).max() < 0.5


@pytest.mark.slow
def test_the_lens_from_pictures_of_a_board(tmp_path: Path) -> None:
    """Catches a table [camera] that the robot file refuses, or another lens than the one that took the pictures."""
    for k, taken in enumerate(photographed(chessboard((9, 6), 40), 12, 5)):
        cv2.imwrite(str(tmp_path / f"board_{k:02d}.png"), taken)
    cv2.imwrite(str(tmp_path / "none.png"), np.full((640, 1280), 128, np.uint8))
    (tmp_path / "text.png").write_text("text")
    made = sherkit("intrinsics", tmp_path, "--chessboard", "9x6", "--square-mm", "20", "-o", tmp_path / "camera.toml")
    assert made.exit_code == 0, made.output
    assert "none.png: the board was not found" in " ".join(made.stderr.split())
    assert "text.png: is not a picture that can be read" in " ".join(made.stderr.split())
    lens = tomllib.loads((tmp_path / "camera.toml").read_text())["camera"]
    assert lens["focal_px"] == pytest.approx(CAMERA.focal_px, rel=5e-3)
    placed = {**lens, "phi_deg": 90.0, "gamma_deg": 45.0, "distance_mm": 446.2}
    (tmp_path / "robot.toml").write_text(tomli_w.dumps({**tomllib.loads(DIAMOND.read_text()), "camera": placed}))
    read = load_robot(tmp_path / "robot.toml")
    assert isinstance(read, Spherical)
    assert read.seen.focal_px == tuple(lens["focal_px"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("markers", "nowhere.png"), "nowhere.png: there is no such picture or folder"),
        (("markers", "empty"), "empty: holds no pictures"),
        (("markers", "0"), "say for how long, with --seconds"),
        (("markers", "a.avi", "b.avi"), "give it alone"),
        (("markers", "a.avi"), "there is no such video"),
        (("markers", "dark.png", "--joints", "few.csv"), "1 pictures for 2 rows of joints"),
        (("markers", "dark.png", "--joints", "one.csv"), "no picture shows the marker; "),
        (("markers", "dark.png", "--joints", "other.csv"), "column 'theta1_rad' is missing; it has q1_mm"),
        (("markers", "dark.png", "--joints", "hole.csv"), "row 0, column 'theta2_rad': expected a finite number"),
        (("markers", "text.png"), "is not a picture that can be read"),
        (("intrinsics", "dark.png", "--square-mm", "10"), "either --chessboard or --charuco"),
        (("intrinsics", "dark.png", "--square-mm", "10", "--chessboard", "9"), "as 9x6, got '9'"),
        (("intrinsics", "dark.png", "--square-mm", "10", "--chessboard", "9x6"), "expected 4 or more"),
        (("intrinsics", "dark.png", "--square-mm", "10", "--charuco", "9x6"), "--marker-mm goes with --charuco"),
    ],
)
def test_wrong_pictures_are_refused(
    arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a traceback where a person needs to hear which file is wrong."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    cv2.imwrite("dark.png", np.full((64, 64), 9, np.uint8))
    (tmp_path / "text.png").write_text("text")
    for name, text in {
        "one.csv": "theta1_rad,theta2_rad\n1,2\n",
        "few.csv": "theta1_rad,theta2_rad\n1,2\n2,3\n",
        "other.csv": "q1_mm\n1\n",
        "hole.csv": "theta1_rad,theta2_rad\n1,\n",
    }.items():
        (tmp_path / name).write_text(text)
    more = ("-o", "out.csv") if arguments[0] == "markers" else ()
    refused = sherkit(*arguments, *more)
    assert isinstance(refused.exception, SherkitError), refused.output
    assert says in str(refused.exception)
