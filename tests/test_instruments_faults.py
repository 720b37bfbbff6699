"""What goes wrong on a line, at random: no wrong value comes back, and nothing moves on after an error."""

from __future__ import annotations

import math
import random
import socket
import threading
import time

import numpy as np
import pytest

from sherkit.errors import Disconnected, InstrumentError, OutOfRange
from sherkit.lab.emulators import (
    Faults,
    GalilEmulator,
    HyperionEmulator,
    KeyenceEmulator,
    NetFtEmulator,
    Sm130Emulator,
    StillRobot,
    World,
)
from sherkit.lab.instruments import Axis, Galil, Hyperion, Keyence, NetFT, Scale, Sm130

COUNTS_PER_MM = 10000.0
AXES = [Axis(x, COUNTS_PER_MM, (-40.0, 40.0)) for x in "ABC"]
NOISE_MM = 0.0002
#: Half a count of rounding, and the noise of the lasers.
CLOSE_MM = 0.00006
LASERS_MM = 6 * NOISE_MM + 0.0001
LINE_FAULTS = ("drop", "garble", "stall", "disconnect", "misheard")


class Mixing(StillRobot):
    """Values of all instruments differ from each other and from pose to pose: a swapped or old one shows."""

    def lasers_mm(self, joints_mm, time_s):
        a, b, c = (float(q) for q in joints_mm)
        return [0.2 * a + 0.1 * b + 5.0, 0.3 * b - 0.2 * c, 0.1 * a + 0.2 * c - 7.0]

    def wavelengths_nm(self, joints_mm, time_s):
        a, b, c = (float(q) for q in joints_mm)
        return [[1530.0 + 0.1 * a, 1545.0 + 0.1 * b], [1560.0 + 0.1 * c], [], []]

    def wrench(self, joints_mm, time_s):
        a, b, c = (float(q) for q in joints_mm)
        return [a, b, c, 10 * a, 10 * b, 10 * c]


def settled(world):
    """The joints, once seen twice at the same place: a long time apart in a fast world."""
    before = world.joints()
    time.sleep(0.02)
    return before if np.array_equal(before, world.joints()) else None


def again(action, instrument, attempts=60):
    """What a runner does: the step once more, on a new connection where the old one is gone."""
    errors = []
    for _ in range(attempts):
        try:
            if not instrument.connected:
                instrument.connect()
            return action(), errors
        except InstrumentError as error:
            errors.append(error)
            if isinstance(error, Disconnected):
                try:
                    instrument.connect()
                except InstrumentError as second:
                    errors.append(second)
                    time.sleep(0.02)
    raise AssertionError(f"no success in {attempts} attempts; last: {errors[-1]}")


def polls_before_stop(log):
    """How many polls of a motion came after the last fault before the axes were told to stop, None without a stop."""
    stop = next((k for k, (c, _, _) in enumerate(log) if c.startswith(b"ST")), None)
    if stop is None:
        return None
    faulty = [k for k, (_, _, fault) in enumerate(log[:stop]) if fault is not None]
    if not faulty:
        return None
    return sum(c.startswith(b"MG _BG") for c, _, _ in log[faulty[-1] + 1 : stop])


def watched_move(galil, target, emulator):
    """A move; where it fails, the axes were told to stop within one poll of the fault, and stand."""
    begin = len(emulator.log)
    failed = True
    try:
        reading = galil.move(target)
        failed = False
    finally:
        if failed:
            # an axis of the real machine would still be on its way: 20 ms here are 8 s there
            assert settled(emulator.world) is not None
            assert (polls_before_stop(emulator.log[begin:]) or 0) <= 1
    return reading


def place(world, rng):
    """Puts the joints somewhere else."""
    for joint in range(3):
        q = rng.uniform(-40.0, 40.0)
        world.set_joint(joint, lambda _, q=q: q)


def one_run(kinds, link, steps, seed, rate=0.03):
    """Steps of a measurement under random faults. Returns how often something was raised."""
    rng = random.Random(seed)
    world = World((0.0, 0.0, 0.0), robot=Mixing(), time_scale=400.0)
    line = {"link": link, "pieces": 3, "gap_s": 0.0005}
    rates = {k: rate / len(kinds) for k in kinds}
    motor_faults = Faults(rates, seed=seed, stall_s=0.25)
    laser_faults = Faults({("over_range" if k == "limit_switch" else k): r for k, r in rates.items()}, seed + 1, 0.25)
    raised = 0
    with (
        GalilEmulator(world, COUNTS_PER_MM, faults=motor_faults, chatty=0.1, seed=seed, **line) as ge,
        KeyenceEmulator(world, noise_mm=NOISE_MM, faults=laser_faults, seed=seed, **line) as ke,
    ):
        settings = {"poll_s": 0.002, "timeout_s": 0.15, "poll_timeout_s": 0.15, "stop_timeout_s": 20.0}
        g = Galil(ge.address, AXES, name="rails", speed=20.0, acceleration=200.0, **settings)
        k = Keyence(ke.address, name="lasers", timeout_s=0.15)
        for _ in range(steps):
            target = [round(rng.uniform(-39.0, 39.0), 3) for _ in range(3)]
            reading, errors = again(lambda t=target: watched_move(g, t, ge), g)
            raised += len(errors)
            for error in errors:
                check_sentence(error, "rails", ge.address)
            true = world.joints()
            assert settled(world) is not None
            assert np.abs(true - target).max() < 0.011
            assert np.abs(np.array(reading.values) - true).max() <= CLOSE_MM
            lasers, errors = again(lambda: k.read_confirmed(LASERS_MM), k)
            raised += len(errors)
            for error in errors:
                check_sentence(error, "lasers", ke.address)
            assert np.abs(np.array(lasers.values) - world.lasers_mm()).max() <= 2 * LASERS_MM
        g.close()
        k.close()
        happened = len(motor_faults.happened) + len(laser_faults.happened)
    return raised, happened


def check_sentence(error, name, address):
    """Which instrument and port; what was sent and received, where anything was."""
    sentence = str(error)
    assert sentence.startswith(f"{name} on {address}: ")
    if error.sent:
        assert f"sent {error.sent[:10]!r}"[:-1] in sentence
        assert "received" in sentence


@pytest.mark.parametrize(
    ("kind", "link"),
    [("drop", "pty"), ("stall", "tcp"), ("garble", "pty"), ("misheard", "tcp"), ("limit_switch", "pty"),
     ("disconnect", "pty"), ("disconnect", "tcp")],
)  # fmt: skip
def test_random_faults_give_no_wrong_value(kind, link):
    """Catches a late, damaged or foreign answer that is taken for a value, and motion after an error. What a fault does
    to a line is the same on both links, but for its end; the long test has all."""
    _, happened = one_run([kind], link, 8, seed=1, rate=0.06)
    assert happened > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*LINE_FAULTS, "limit_switch"])
@pytest.mark.parametrize("link", ["pty", "tcp"])
def test_random_faults_over_a_thousand_steps(kind, link):
    """Catches what the short test does, where it is rare."""
    raised, happened = one_run([kind], link, 1000, seed=7)
    print(f"{kind} on {link}: {happened} faults, {raised} errors raised, no wrong value")
    assert happened > 200


@pytest.mark.slow
@pytest.mark.parametrize("link", ["pty", "tcp"])
def test_all_faults_at_once_over_a_thousand_steps(link):
    """Catches faults that hide each other: a late answer behind a damaged one, a stop that is not heard."""
    raised, happened = one_run([*LINE_FAULTS, "limit_switch"], link, 1000, seed=11, rate=0.05)
    print(f"all on {link}: {happened} faults, {raised} errors raised, no wrong value")
    assert happened > 500


@pytest.mark.parametrize("kind", LINE_FAULTS)
def test_a_fault_of_each_answer_of_a_move(kind):
    """Catches the one answer of a move whose loss is taken for success, or leaves an axis moving."""
    world = World((0.0, 0.0, 0.0), time_scale=400.0)
    faults = Faults(seed=3, stall_s=0.25)
    with GalilEmulator(world, COUNTS_PER_MM, link="tcp", faults=faults) as e:
        settings = {"poll_s": 0.002, "timeout_s": 0.15, "poll_timeout_s": 0.15, "stop_timeout_s": 20.0}
        g = Galil(e.address, AXES, **settings).connect()
        g.move([1.0, 2.0, 3.0])
        for k in range(9):
            target = [3.0 * (-1) ** k, k, -k]
            faults.schedule(kind, k)
            try:
                reading = g.move(target)
            except InstrumentError:
                assert settled(world) is not None
                reading, _ = again(lambda t=target: g.move(t), g)
            assert np.abs(np.array(reading.values) - world.joints()).max() <= CLOSE_MM
            assert np.abs(world.joints() - target).max() < 0.011
        g.close()


def test_an_answer_that_comes_too_late_is_not_the_next_one():
    """Catches a driver that takes the answer to an older question for that to its present one."""
    world = World((1.0, 2.0, 3.0), robot=Mixing())
    faults = Faults()
    with GalilEmulator(world, COUNTS_PER_MM, faults=faults) as e, Galil(e.address, AXES, timeout_s=0.5) as g:
        faults.schedule("stall", 0, 0.8)
        with pytest.raises(InstrumentError):
            g.command("MG _TPC")
        assert g.read().values == (1.0, 2.0, 3.0)
    for link in ("pty", "tcp"):
        with KeyenceEmulator(world, link=link, faults=faults) as e, Keyence(e.address, (1,), timeout_s=0.5) as k:
            assert k.read().values[0] == pytest.approx(5.4)
            k.retries = 0
            faults.schedule("stall", 0, 0.8)
            with pytest.raises(InstrumentError):
                k.read()
            # the old value is on its way when the world has changed
            world.set_joint(0, lambda _: 11.0)
            assert k.read().values[0] == pytest.approx(7.4)
            world.set_joint(0, lambda _: 1.0)


def test_a_stop_that_cannot_be_sent_says_so():
    """Catches an error that lets a user believe that the axes stand, where nobody can know."""
    world = World((0.0, 0.0, 0.0))
    e = GalilEmulator(world, COUNTS_PER_MM, link="tcp").start()
    g = Galil(e.address, AXES, poll_s=0.01, stop_timeout_s=0.3, poll_timeout_s=0.3).connect()
    threading.Timer(0.3, e.stop).start()
    with pytest.raises(InstrumentError, match="emergency stop"):
        g.move([40.0, 0.0, 0.0])
    g._moving.clear()
    g.close()


@pytest.mark.parametrize(
    ("emulator", "driver", "noise"), [(Sm130Emulator, Sm130, "noise_nm"), (HyperionEmulator, Hyperion, "noise_nm")]
)
def test_interrogators_under_faults(emulator, driver, noise):
    """Catches peaks of a damaged or older answer, and lost peaks that shift the others."""
    world = World((0.0, 0.0, 0.0), robot=Mixing())
    kinds = (*LINE_FAULTS, "over_range")
    faults = Faults(dict.fromkeys(kinds, 0.02), seed=5, stall_s=0.15)
    rng = random.Random(2)
    with emulator(world, faults=faults, pieces=4, gap_s=0.0005, **{noise: 0.0001}) as e:
        d = driver(e.address, (2, 1), name="fibres", timeout_s=0.1)
        for _ in range(80):
            place(world, rng)
            reading, errors = again(lambda: d.read_confirmed(0.002), d)
            for error in errors:
                check_sentence(error, "fibres", e.address)
            true = [v for channel in world.wavelengths_nm() for v in channel]
            assert np.abs(np.array(reading.values) - true).max() < 0.003
        d.close()
    assert len({f.kind for f in faults.happened}) == len(kinds)


def test_net_ft_under_faults():
    """Catches a saturated, damaged or older record that is taken for a load."""
    world = World((0.0, 0.0, 0.0), robot=Mixing())
    kinds = ("drop", "garble", "stall", "over_range", "disconnect")
    faults = Faults(dict.fromkeys(kinds, 0.03), seed=5, stall_s=0.08)
    rng = random.Random(2)
    with NetFtEmulator(world, faults=faults, noise=0.001) as e:
        d = NetFT(e.address, Scale(1e6, 1e6), name="tool", timeout_s=0.05)
        for _ in range(80):
            place(world, rng)
            reading, errors = again(lambda: d.read_confirmed(0.02), d)
            for error in errors:
                check_sentence(error, "tool", e.address)
            assert np.abs(np.array(reading.values) - world.wrench()).max() < 0.03
        d.close()


@pytest.mark.parametrize("driver", ["galil", "keyence", "sm130", "hyperion"])
def test_a_talker_of_nonsense_is_an_error_in_time(driver):
    """Catches a driver that hangs, or raises something else, at another device's port."""
    rng = random.Random(4)
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        while True:
            try:
                client, _ = server.accept()
            except OSError:
                return
            with client:
                try:
                    while client.recv(4096):
                        words = [
                            b":", b"?", b"\r", b"\r\n:", b"MS,01,", b"0000000092", rng.randbytes(rng.randrange(120)),
                        ]  # fmt: skip
                        client.sendall(b"".join(rng.choices(words, k=4)))
                except OSError:
                    continue

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
    made = {
        "galil": lambda: Galil(address, AXES, timeout_s=0.05, poll_timeout_s=0.05, retries=1),
        "keyence": lambda: Keyence(address, timeout_s=0.05, retries=1),
        "sm130": lambda: Sm130(address, (1,), timeout_s=0.05, retries=1),
        "hyperion": lambda: Hyperion(address, (1,), timeout_s=0.05, retries=1),
    }[driver]
    for _ in range(8):
        instrument = made()
        with pytest.raises(InstrumentError):
            instrument.connect().read_confirmed(0.001)
        instrument.close()
    # shut down: closing alone does not wake the thread
    server.close()


def test_empty_cells_stay_empty_when_confirmed():
    """Catches a confirmation that never ends, or fails, on a head that sees nothing."""
    with (
        KeyenceEmulator(World((1.0, math.nan))) as e,
        Keyence(e.address, (1, 2), empty=True) as k,
    ):
        assert math.isnan(k.read_confirmed(0.001).values[1])
        k.empty = False
        with pytest.raises(OutOfRange):
            k.read_confirmed(0.001)


def test_an_answer_of_another_question_is_no_identity(monkeypatch):
    """Catches a late answer that makes the controller another one, and a run that is refused for it."""
    with GalilEmulator(World((130.0, 130.0, 130.0))) as rails, Galil(rails.address, AXES, timeout_s=5.0) as galil:
        known, asked = galil.identify(), Galil.command
        late = {"\x12\x16": ["4183.0000"], "MG _BN": ["DMC4183 Rev 1.3a"]}

        def answered(self, text, timeout_s=None):
            data = asked(self, text, timeout_s)
            return late[text].pop() if late.get(text) else data

        monkeypatch.setattr(Galil, "command", answered)
        assert galil.identify() == known
        assert not any(late.values())
