"""Drivers against emulators over real ports, and both against the bytes of the makers' documents."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from serial import serial_for_url
from serial.rfc2217 import PortManager

from sherkit.errors import (
    Disconnected,
    Garbled,
    Halted,
    InstrumentError,
    NotReferenced,
    OutOfRange,
    Refused,
    ShapeError,
    Timeout,
)
from sherkit.lab.emulators import (
    CameraEmulator,
    Faults,
    GalilEmulator,
    HyperionEmulator,
    KeyenceEmulator,
    NetFtEmulator,
    Profile,
    Sm130Emulator,
    StillRobot,
    World,
)
from sherkit.lab.instruments import Axis, Galil, Hyperion, Keyence, NetFT, Scale, Sm130, VideoCamera, fetch_scale
from sherkit.lab.instruments.base import Reading, middle_of
from sherkit.lab.instruments.galil_line import parse_answer, parse_galil_numbers
from sherkit.lab.instruments.keyence import parse_reply, parse_value
from sherkit.lab.instruments.transport import TcpPort, deadline_in, open_port

LINKS = ("pty", "tcp")
AXES = (
    Axis("A", 10000.0, (-50.0, 50.0)),
    Axis("B", -4000.0, (-20.0, 60.0), 1234, "q2"),
    Axis("C", 2048.0, (0.0, 10.0)),
)


def emulated(world, **line):
    return GalilEmulator(world, [a.counts_per_unit for a in AXES], zero_counts=[a.zero_counts for a in AXES], **line)


def controller(address, **settings):
    return Galil(address, AXES, **({"poll_s": 0.01, "timeout_s": 5.0, "poll_timeout_s": 5.0} | settings))


def stands(world):
    """Whether no joint moves, as seen over a long time of a fast world."""
    before = world.joints()
    time.sleep(0.05)
    return bool(np.array_equal(before, world.joints()))


def raw(address, sent, count=4096, quiet_s=0.3):
    """What a plain socket gets back."""
    host, port = address.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port))) as s:
        s.sendall(sent)
        s.settimeout(quiet_s)
        got = b""
        while len(got) < count:
            try:
                piece = s.recv(4096)
            except TimeoutError:
                break
            if not piece:
                break
            got += piece
    return got


# --- the bytes of the documents


def test_of_three_readings_one_may_be_wrong():
    """Catches a digit that noise on the line turned, by less than two readings may differ, taken for a position: 0.002
    of 0.010 mm in one reading's first axis, of whichever of the three."""
    places = [(1.0, 2.0), (1.001, 2.0), (1.0005, 2.001)]
    for wrong in range(3):
        said = [(x + 0.002 * (k == wrong) * 4, y) for k, (x, y) in enumerate(places)]
        readings = [Reading("rails", ("a", "b"), values, ("mm", "mm"), 0.0) for values in said]
        assert max(abs(a - b) for a, b in zip(middle_of(*readings).values, (1.0005, 2.0), strict=True)) <= 0.001


def test_galil_emulator_speaks_the_documents_bytes():
    """Catches an emulator that agrees with its driver on bytes that no controller sends."""
    with GalilEmulator(World((0.02, -0.001, 0.0)), 10000.0, link="tcp") as e:
        assert raw(e.address, b"TP\r", 18) == b" 200, -10, 0\r\n:"
        assert raw(e.address, b"MG _TPA\r", 13) == b" 200.0000\r\n:"
        assert raw(e.address, b"MG _TPA,_TPB\r") == b" 200.0000 -10.0000\r\n:"
        assert raw(e.address, b"XX\rTC1\rTC\r") == b"?1 Unrecognized command\r\n:0\r\n:"
        assert raw(e.address, b"PA 400,,500;PA ?,?,?\r") == b":" + b" 400, -10, 500\r\n:"
        assert raw(e.address, b"PAA=999999999999\rTC\r") == b"?6\r\n:"
        assert raw(e.address, b"pa 1\rAM\rMC\r") == b"???"
        assert raw(e.address, b"MOA\rPA 500\rBGA\rTC1\rMG _TSA\r") == (
            b"::?20 Begin not valid with motor off\r\n: 46.0000\r\n:"
        )
        assert raw(e.address, b"MG " + b"1" * 80 + b"\r") == b"?"


def test_galil_driver_reads_the_documents_bytes():
    """Catches a parser that takes an echo, a refusal or a lost line end for a value."""
    assert parse_galil_numbers(parse_answer(b" 200, -10, 0\r\n:"), 3) == (200.0, -10.0, 0.0)
    assert parse_galil_numbers(parse_answer(b" 200.0000 -10.0000\r\n:"), 2) == (200.0, -10.0)
    assert parse_answer(b":") == ""
    # CW1: unsolicited text has its high bit set, and may hold prompts
    assert parse_answer(b" 2" + bytes(b | 0x80 for b in b"HI:\r\n") + b"00.0000\r\n:") == " 200.0000"
    with pytest.raises(Refused):
        parse_answer(b"?")
    for bad in (b" 20:", b" 200.0000:", b"", b"\r\n", b" 2\x0100.0\r\n:"):
        with pytest.raises(Garbled):
            parse_answer(bad)


def test_keyence_speaks_the_documents_bytes():
    """Catches a wrong place of the point, a wrong header, and an error taken for a value, on both sides."""
    assert parse_value(*parse_reply(b"MS,01,+000.073\r", "MS,01")) == 0.073
    assert parse_reply(b"MM,110000000000,+000.073,-00.0021\r", "MM,110000000000") == ("+000.073", "-00.0021")
    with pytest.raises(Refused) as refused:
        parse_reply(b"ER,MS,22\r", "MS,01")
    assert refused.value.code == 22
    for far in ("+FFFFFFF", "-FFFFFFF"):
        with pytest.raises(OutOfRange):
            parse_value(far)
    assert math.isnan(parse_value("XXXXXXXX"))
    for bad in ("+00.073", "000.0730", "+0000073", "+00.0.73", "+000,073", "+FFFFFFE"):
        with pytest.raises(Garbled):
            parse_value(bad)
    with pytest.raises(Garbled):
        parse_reply(b"MS,02,+000.073\r", "MS,01")
    with KeyenceEmulator(World((0.073, -1234.0, 2.0)), link="tcp", decimals=3) as e:
        assert raw(e.address, b"MS,01\r") == b"MS,01,+000.073\r"
        assert raw(e.address, b"MM,111100000000\r") == b"MM,111100000000,+000.073,-FFFFFFF,+002.000,XXXXXXXX\r"
        assert raw(e.address, b"Q0\rMS,01\rR0\rMS,13\r") == b"Q0\rER,MS,02\rR0\rER,MS,04\r"


def test_sm130_emulator_lays_out_the_documents_header():
    """Catches a header with a field at the wrong place, which the driver might share."""
    with Sm130Emulator(World()) as e:
        got = raw(e.address, b"#GET_DATA\n", 10 + 92)
    assert got[:10] == b"0000000092"
    header = got[10:98]
    assert struct.unpack_from("<H", header, 16) == (1,)
    assert struct.unpack_from("<H", header, 50) == (88,)
    assert struct.unpack("<I", got[98:])[0] / struct.unpack_from("<I", header, 72)[0] == 1550.0


def test_profile_is_a_trapezoid():
    """Catches a profile that jumps, exceeds its speed or acceleration, or misses its end."""
    for way in (0.001, 0.5, 30.0, -30.0):
        p = Profile(1.0, 1.0 + way, 5.0, 50.0, 20.0, 2.0)
        t = np.linspace(1.5, p.end_s + 0.5, 50_001)
        x = np.array([p.at(float(v)) for v in t])
        dt = t[1] - t[0]
        speed = np.diff(x) / dt
        assert x[0] == 1.0
        assert x[-1] == 1.0 + way
        assert np.abs(speed).max() <= 5.0 * 1.001
        assert np.abs(np.diff(speed) / dt).max() <= 50.0 * 1.05
        assert np.abs(speed[:-1] - [p.speed_at(float(v)) for v in t[1:-1]]).max() < 0.01
        braking = p.stopped(2.0 + 0.4 * (p.end_s - 2.0))
        assert abs(braking.end - 1.0) <= abs(way) + 1e-12


# --- ports


def serving(answer):
    """A TCP port whose every client is served by ``answer(socket)`` in a thread."""
    server = socket.create_server(("127.0.0.1", 0))

    def run():
        while True:
            try:
                client, _ = server.accept()
            except OSError:
                return
            with client, contextlib.suppress(OSError):
                answer(client)

    threading.Thread(target=run, daemon=True).start()
    return server, server.getsockname()[1]


def test_port_ends_at_its_deadline_although_bytes_keep_coming():
    """Catches a deadline that starts anew with each byte."""

    def dribble(client):
        for _ in range(10_000):
            client.sendall(b"x")
            begun.set()
            time.sleep(0.01)

    begun = threading.Event()
    server, number = serving(dribble)
    port = TcpPort("127.0.0.1", number)
    assert begun.wait(600.0)
    with pytest.raises(Timeout) as late:
        port.read_until(b"\r", deadline_in(0.3))
    with pytest.raises(Timeout):
        port.read_exactly(100_000, deadline_in(0.3))
    port.drain(1.0)
    assert set(late.value.received) == {ord("x")}
    port.close()
    with pytest.raises(Disconnected):
        port.read_exactly(1, deadline_in(1.0))
    server.close()


def test_port_bounds_its_buffer():
    """Catches a reader that fills the memory with a line without an end."""

    def flood(client):
        while True:
            client.sendall(b"y" * 65536)

    server, number = serving(flood)
    port = TcpPort("127.0.0.1", number)
    with pytest.raises(Garbled, match="without an end"):
        port.read_until(b"\r", deadline_in(600.0))
    with pytest.raises(Garbled, match="at most"):
        port.read_exactly(1 << 30, deadline_in(600.0))
    port.close()
    server.close()


def test_port_keeps_what_came_too_early():
    """Catches bytes behind a terminator that are thrown away, and terminators that arrive in two pieces."""

    def speak(client):
        for piece in (b"one\r", b"\ntwo\r\nthree", b"45\r\n"):
            client.sendall(piece)
            time.sleep(0.02)
        time.sleep(5.0)

    server, number = serving(speak)
    port = TcpPort("127.0.0.1", number)
    assert port.read_until(b"\r\n", deadline_in(600.0)) == b"one\r\n"
    assert port.read_until((b"??", b"\r\n"), deadline_in(600.0)) == b"two\r\n"
    assert port.read_exactly(6, deadline_in(600.0)) == b"three4"
    assert port.read_until(b"\n", deadline_in(600.0)) == b"5\r\n"
    port.close()
    server.close()


@pytest.mark.parametrize(
    "bad", ["", "ftp://x:1", "serial://x", "tcp://x", "tcp://:5", "tcp://x:0", "tcp://x:70000", "udp://x:5x"]
)
def test_addresses_that_are_none_are_refused(bad):
    """Catches a wrong address that fails late, or with another exception."""
    with pytest.raises(InstrumentError, match=r"expected|address"):
        open_port(bad)


def test_nobody_there_is_disconnected():
    """Catches an OSError or a hang where a cable is not plugged in."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    for address in (f"tcp://127.0.0.1:{number}", "/nowhere/port"):
        with pytest.raises(Disconnected) as error:
            Keyence(address).connect()
        assert "Keyence" in str(error.value)
        assert address in str(error.value)
    with pytest.raises(Disconnected, match="connect"):
        Keyence("/nowhere/port").read()


# --- Galil


@pytest.mark.parametrize("link", LINKS)
def test_galil_moves_where_it_was_told(link):
    """Catches wrong signs, zeros and scales of axes, answers in pieces, echo, and unsolicited text between them."""
    world = World((1.0, 2.0, 3.0), time_scale=50.0)
    with emulated(world, link=link, pieces=4, chatty=0.3, lag_s=0.5, noise_counts=0.3) as e, controller(e.address) as g:
        assert "DMC4183" in g.identify().text
        assert g.read().values == pytest.approx((1.0, 2.0, 3.0), abs=1e-3)
        before = time.time()
        reading = g.move([-5.0, 40.0, 9.5])
        assert before - 1 <= reading.time_s <= time.time() + 1
        assert reading.unit == "mm"
        assert reading.names == ("A", "q2", "C")
        assert world.joints() == pytest.approx([-5.0, 40.0, 9.5], abs=1e-3)
        assert reading["q2"] == pytest.approx(40.0, abs=2e-3)
        assert g.move({"q2": -3.0})["q2"] == pytest.approx(-3.0, abs=2e-3)
        assert world.joints() == pytest.approx([-5.0, -3.0, 9.5], abs=1e-3)
        assert not g.is_moving()
        assert g.read_commanded().values == pytest.approx((-5.0, -3.0, 9.5), abs=1e-3)
        with pytest.raises(ShapeError, match="q3"):
            reading["q3"]


def test_galil_connecting_moves_nothing():
    """Catches a driver that enables, homes or moves on connecting."""
    world = World((1.0, 2.0, 3.0))
    with emulated(world) as e:
        with controller(e.address) as g:
            g.identify()
            g.read()
        said = {command.strip()[:2] for command, _, _ in e.log}
    assert said == {b"", b"EO", b"CW", b"MG", b"\x12\x16"}


@pytest.mark.parametrize("target", [(50.1, 0, 0), (0, -20.1, 5), (0, 0, -0.001), (math.nan, 0, 0), (0, math.inf, 0)])
def test_galil_soft_limits_are_never_sent(target):
    """Catches a target outside the limits, or no number, that reaches the controller."""
    with emulated(World((0.0, 0.0, 5.0))) as e, controller(e.address) as g:
        with pytest.raises(OutOfRange, match="soft limits"):
            g.move(target)
        with pytest.raises(InstrumentError):
            g.move({"Q": 1.0})
        with pytest.raises(InstrumentError):
            g.move([1.0])
        assert not any(c[:2] in (b"PA", b"BG") for c, _, _ in e.log)


def test_galil_gives_its_limits_to_the_controller():
    """Catches soft limits that end with the program, or are swapped on an axis that counts the other way."""
    world = World((0.0, 0.0, 5.0), time_scale=100.0)
    with emulated(world, link="tcp") as e, controller(e.address) as g:
        g.move({"A": 1.0})
        assert (e.axes["A"].settings["BL"], e.axes["A"].settings["FL"]) == (-500000, 500000)
        assert (e.axes["B"].settings["BL"], e.axes["B"].settings["FL"]) == (1234 - 240000, 1234 + 80000)
        # another program that asks for more is stopped there
        raw(e.address, b"PAA=900000\rBGA\r")
        deadline = time.monotonic() + 600.0
        while g.is_moving() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert world.joints()[0] < 50.5


def test_galil_errors_name_code_and_bytes():
    """Catches a refusal without the controller's reason, or a sentence without instrument, port and bytes."""
    with emulated(World((0.0, 0.0, 5.0), time_scale=100.0)) as e, controller(e.address, name="rails") as g:
        g.disable()
        with pytest.raises(NotReferenced, match=r"the drive of A, q2, C is off\. Nothing was moved"):
            g.move({"A": 1.0})
        with pytest.raises(Refused) as refused:
            g.command("BGA")
        assert refused.value.code == 20
        assert "motor off" in refused.value.text
        sentence = str(refused.value)
        for part in ("rails", e.address, "BGA", "'?'", "20"):
            assert part in sentence
        g.enable()
        assert g.move({"A": 1.0})["A"] == pytest.approx(1.0, abs=1e-3)


def test_galil_stops_at_a_limit_switch():
    """Catches a motion that ended at a switch and counts as arrived."""
    world = World((0.0, 0.0, 5.0), time_scale=50.0)
    with emulated(world, travel=[(-10, 10), (-30, 70), (-1, 11)]) as e, controller(e.address) as g:
        with pytest.raises(Halted, match="forward limit") as halted:
            g.move({"A": 40.0})
        assert halted.value.code == 2
        assert stands(world)
        assert 10.0 <= world.joints()[0] < 11.0
        # the controller refuses to go further, and does go back
        with pytest.raises(Refused) as refused:
            g.move({"A": 40.0})
        assert refused.value.code == 22
        assert g.move({"A": 0.0})["A"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("link", LINKS)
def test_galil_stop_from_another_thread(link):
    """Catches a stop that waits for the motion's end, or a stopped motion that counts as arrived."""
    world = World((0.0, 0.0, 5.0))
    with emulated(world, link=link) as e, controller(e.address) as g:
        failed = []

        def move():
            try:
                g.move({"A": 50.0})
            except InstrumentError as error:
                failed.append(error)

        thread = threading.Thread(target=move)
        thread.start()
        while not g.is_moving():
            time.sleep(0.01)
        g.stop()
        assert stands(world)
        thread.join(600.0)
        assert isinstance(failed[0], Halted)
        assert failed[0].code == 4
        # ST with axes: a bare one would halt the controller's own program
        assert not any(c.strip() == b"ST" for c, _, _ in e.log)


def test_galil_close_stops_what_moves():
    """Catches a motion that outlives its connection."""
    world = World((0.0, 0.0, 5.0))
    with emulated(world, link="tcp") as e:
        g = controller(e.address).connect()

        def move():
            with pytest.raises(InstrumentError):
                g.move({"A": 50.0})

        thread = threading.Thread(target=move)
        thread.start()
        while not g.is_moving():
            time.sleep(0.01)
        g.close()
        assert stands(world)
        thread.join(600.0)


PROGRAM = """
import sys, threading, time
from sherkit.lab.instruments import Axis, Galil
g = Galil(sys.argv[1], [Axis("A", 10000.0, (-50.0, 50.0))], poll_s=0.01).connect()
if sys.argv[2] == "ctrl-c":
    print("moving", flush=True)
    g.move([50.0])
else:
    threading.Thread(target=g.move, args=([50.0],), daemon=True).start()
    while not g.is_moving():
        time.sleep(0.01)
    print("moving", flush=True)
"""


@pytest.mark.parametrize("how", ["ctrl-c", "exit"])
def test_galil_stops_on_ctrl_c_and_at_exit(how):
    """Catches a motion that goes on when its program is interrupted or ends."""
    world = World((0.0,))
    with GalilEmulator(world, 10000.0, link="tcp") as e:
        program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, e.address, how], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert program.stdout.readline() == "moving\n"
        if how == "ctrl-c":
            while world.joints()[0] == 0.0:
                time.sleep(0.01)
            program.send_signal(signal.SIGINT)
        _, stderr = program.communicate(timeout=600.0)
        assert stands(world)
        assert 0.0 < world.joints()[0] < 49.0
        assert ("KeyboardInterrupt" in stderr) == (how == "ctrl-c")


def test_galil_refuses_what_is_no_setting():
    """Catches a scale of zero, swapped limits or a doubled axis that would show as a wild motion."""
    for axis in (
        ("A", 0.0, (0, 1)),
        ("A", math.nan, (0, 1)),
        ("A", 1.0, (1, 0)),
        ("I", 1.0, (0, 1)),
        ("", 1.0, (0, 1)),
    ):
        with pytest.raises(InstrumentError):
            Axis(*axis)
    with pytest.raises(InstrumentError):
        Galil("x", [AXES[0], AXES[0]])
    with pytest.raises(InstrumentError):
        Galil("x", AXES, speed=0.0)
    with pytest.raises(InstrumentError, match="home_speed is 0"):
        Galil("x", AXES, home_speed=0.0)
    with pytest.raises(InstrumentError, match="single command"):
        Galil("x", AXES).command("BGA;PAA=9")


# --- lasers, gratings, forces, pictures


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("method", ["MS", "MM", "MA"])
def test_keyence_reads_its_heads(link, method):
    """Catches swapped outputs, a lost sign, and answers in pieces."""
    with (
        KeyenceEmulator(World((1.25, -0.5, 12.0625)), link=link, pieces=5) as e,
        Keyence(e.address, (1, 3), names=("x", "z"), method=method, timeout_s=5.0) as k,
    ):
        reading = k.read()
        assert (reading["x"], reading["z"]) == (1.25, 12.0625)
        assert reading.unit == "mm"
        k.set_communication_mode()
        with pytest.raises(Refused, match="refused with code"):
            k.read()
        k.set_measuring_mode()
        assert k.identify().port == e.address


def test_keyence_out_of_range_is_no_value():
    """Catches a lost beam that is read as a number, and an output without a head that is read as zero."""
    with KeyenceEmulator(World((1.0, math.nan)), range_mm=5.0) as e:
        with Keyence(e.address, (1, 2)) as k, pytest.raises(OutOfRange, match="out2") as lost:
            k.read()
        assert "FFFFFFF" in str(lost.value)
        with Keyence(e.address, (1, 3)) as k, pytest.raises(OutOfRange, match="out3"):
            k.read()
        with Keyence(e.address, (1, 2, 3), empty=True) as k:
            values = k.read().values
        assert values[0] == 1.0
        assert math.isnan(values[1])
        assert math.isnan(values[2])


class Gratings(StillRobot):
    def wavelengths_nm(self, joints_mm, time_s):
        q = float(joints_mm[0])
        return [[1540.0 + q, 1550.0], [], [1560.25], [1571.0, 1572.0, 1573.0]]

    def wrench(self, joints_mm, time_s):
        return [1.0, -2.0, 3.5, 100.0, -200.0, 0.125]

    def picture(self, joints_mm, time_s):
        picture = np.zeros((48, 64), np.uint8)
        picture[20, 10 + int(joints_mm[0])] = 255
        return picture


@pytest.mark.parametrize(("emulator", "driver"), [(Sm130Emulator, Sm130), (HyperionEmulator, Hyperion)])
def test_interrogators_read_their_gratings(emulator, driver):
    """Catches channels or peaks in the wrong order, a wrong unit, and a reader that trusts one recv."""
    with emulator(World((0.5,), robot=Gratings()), pieces=6, gap_s=0.003) as e:
        with driver(e.address, (2, 0, 1, 3), timeout_s=10.0) as d:
            assert "emulator" in d.identify().text
            reading = d.read()
            assert reading.names == ("ch1_fbg1", "ch1_fbg2", "ch3_fbg1", "ch4_fbg1", "ch4_fbg2", "ch4_fbg3")
            assert reading.values == pytest.approx((1540.5, 1550.0, 1560.25, 1571.0, 1572.0, 1573.0), abs=1e-9)
            assert reading.unit == "nm"
        with driver(e.address, (2, 1, 1, 3)) as d, pytest.raises(OutOfRange, match="channel 2"):
            d.read()


def test_net_ft_reads_and_counts_lost_records():
    """Catches swapped axes, forces with the scale of torques, and lost or late records that nobody notices."""
    faults = Faults(stall_s=0.05)
    with (
        NetFtEmulator(World((0.0,), robot=Gratings()), counts_per_torque=1000.0, faults=faults) as e,
    ):
        scale = fetch_scale(e.page)
        assert scale == Scale(1e6, 1e3, "N", "Nmm")
        with NetFT(e.address, scale, timeout_s=5.0) as f:
            reading = f.read()
            assert reading.values == pytest.approx((1.0, -2.0, 3.5, 100.0, -200.0, 0.125))
            assert reading.units == ("N", "N", "N", "Nmm", "Nmm", "Nmm")
            for after in (3, 7, 8):
                faults.schedule("drop", after)
            faults.schedule("stall", 20)
            records = list(f.stream(200))
            assert len(records) == 196
            assert (f.lost, f.reordered) == (3, 1)
            faults.schedule("over_range")
            with pytest.raises(OutOfRange, match="0x80000002"):
                f.read()
            f.bias()
            assert f.read()["fx"] == pytest.approx(0.0)


def test_net_ft_pages_that_are_none_are_refused():
    """Catches an XML bomb that is expanded, a scale of zero, and a missing page that is an OSError."""
    from sherkit.lab.instruments.ati import parse_scale

    for bad in (
        b'<!DOCTYPE x [<!ENTITY a "b">]><netft><cfgcpf>&a;</cfgcpf></netft>',
        b"<netft><cfgcpf>0</cfgcpf><cfgcpt>1</cfgcpt></netft>",
        b"<netft><cfgcpf>nan</cfgcpf><cfgcpt>1</cfgcpt></netft>",
        b"<netft><cfgcpf>1</cfgcpf></netft>",
        b"<netft>",
        b"",
    ):
        with pytest.raises(Garbled):
            parse_scale(bad)
    with pytest.raises(Disconnected):
        fetch_scale("http://127.0.0.1:9/netftapi2.xml", 5.0)
    with pytest.raises(InstrumentError):
        fetch_scale("file:///etc/hosts")


def brightest(picture):
    v, u = np.unravel_index(int(picture.argmax()), picture.shape)
    return (float(u), float(v)) if picture.max() == 255 and picture.min() == 0 else (math.nan, math.nan)


def test_camera_grabs_what_is_there_now():
    """Catches an old frame, a cut one, a missing one or a hanging driver that is taken for the picture."""
    world = World((3.0,), robot=Gratings())
    faults = Faults()
    e = CameraEmulator(world, faults=faults)
    with VideoCamera(source=e.source, find=brightest, size_px=(64, 48), timeout_s=1.0) as c:
        assert (c.read()["u"], c.read()["v"]) == (13.0, 20.0)
        for kind in ("drop", "garble", "disconnect"):
            faults.schedule(kind)
            assert c.read()["u"] == 13.0
        faults.schedule("over_range", 4)
        with pytest.raises(OutOfRange, match="not seen"):
            c.read()
        faults.schedule("stall", 0, 3.0)
        assert c.read()["u"] == 13.0
        # without retries each is an error
        c.retries = 0
        for kind, error in (("drop", Garbled), ("garble", Garbled), ("disconnect", Garbled)):
            faults.schedule(kind)
            with pytest.raises(error, match="camera"):
                c.read()
            c.connect()
    with pytest.raises(Disconnected):
        c.read()


def test_camera_that_is_not_there():
    """Catches a traceback of OpenCV's where no camera is plugged in."""
    pytest.importorskip("cv2")
    with pytest.raises(Disconnected, match="cannot be opened"):
        VideoCamera("/nowhere/video.mp4", timeout_s=30.0).connect()


def test_emulators_listen_on_this_machine_alone():
    """Catches an emulator that others on the network can reach without being told to."""
    world = World()
    for e in (
        emulated(world, link="tcp"),
        KeyenceEmulator(world, link="tcp"),
        Sm130Emulator(world),
        NetFtEmulator(world),
    ):
        with e:
            assert "://127.0.0.1:" in e.address


def test_two_programs_cannot_share_a_serial_port():
    """Catches two programs that command the same motors."""
    with emulated(World()) as e, controller(e.address), pytest.raises(Disconnected, match="opened"):
        controller(e.address).connect()


def _serve_rfc2217(listener, address):
    """A server of one serial port (RFC 2217): the line of an emulator, with the port's settings in between."""
    client, _ = listener.accept()
    with (
        contextlib.suppress(ConnectionError),
        client,
        serial_for_url(address.replace("tcp", "socket"), timeout=0) as line,
    ):
        manager = PortManager(line, SimpleNamespace(write=client.sendall))
        while True:
            ready, _, _ = select.select([client, line._socket], [], [])
            if client in ready:
                if not (data := client.recv(4096)):
                    return
                line.write(b"".join(manager.filter(data)))
            if line._socket in ready:
                client.sendall(b"".join(manager.escape(line.read(4096))))


@pytest.mark.filterwarnings("ignore:set(Daemon|Name)")
def test_serial_ports_of_a_server_are_read_by_the_url_of_pyserial():
    """Catches an address of pyserial's that is refused, and a time limit that such a port asks the other end for."""
    world = World((1.0, 2.0, 3.0))
    with KeyenceEmulator(world, link="tcp") as e, socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=_serve_rfc2217, args=(listener, e.address), daemon=True)
        server.start()
        with Keyence(f"rfc2217://127.0.0.1:{listener.getsockname()[1]}", timeout_s=2.0) as k:
            assert k.read().values == (1.0, 2.0, 3.0)
            e.faults.schedule("drop")
            assert k.read().values == (1.0, 2.0, 3.0)
        server.join()


@pytest.mark.parametrize(
    "address", ["spy:///dev/null?file={}", "SPY:///dev/null?file={}", "alt:///dev/null", "rfc2217://x"]
)
def test_an_address_opens_a_port_and_nothing_else(address: str, tmp_path: Path) -> None:
    """Catches an address, which stands in files of other people, by which pyserial empties a file of this machine."""
    precious = tmp_path / "precious"
    precious.write_text("kept")
    with pytest.raises(InstrumentError, match="is no address"):
        Keyence(address.format(precious)).connect()
    assert precious.read_text() == "kept"


def test_drivers_need_no_emulators_and_emulators_no_drivers():
    """Catches an emulator that shares its driver's parsers: both could be wrong alike. And upward imports."""
    code = "import sys, json, sherkit.lab.instruments.devices; print(json.dumps(list(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert not [
        m for m in json.loads(out) if "sherkit.lab.emulators" in m or m.startswith(("bluesky", "ophyd", "pyvisa"))
    ]
    folder = os.path.join(os.path.dirname(sys.modules["sherkit.lab"].__file__), "emulators")
    for name in os.listdir(folder):
        if name.endswith(".py"):
            with open(os.path.join(folder, name), encoding="utf-8") as file:
                assert "instruments" not in "".join(line for line in file if line.startswith(("from", "import")))
