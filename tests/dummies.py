"""Motors and sensors without ports, whose robot is known, and twenty ways in which they fail: for campaigns of runs."""

from __future__ import annotations

import numpy as np

from sherkit.lab.experiment import Bench
from sherkit.lab.experiment.bench import Checks, Sensor, Settling
from sherkit.lab.instruments import Axis, AxisController, AxisReference, Identity, Reading
from sherkit.lab.instruments.base import Instrument
from sherkit.lab.instruments.transport import now_s
from sherkit.model.kinds import kind_of


class Motors(AxisController):
    """Axes that are at once where they are sent. ``slipped`` is by how much each encoder says more than is true."""

    kind = "motors"

    def __init__(self, robot, start, said=True):
        super().__init__("dummy://motors", name="motors")
        names = [n.rsplit("_", 1)[0] for n in kind_of(robot).layout.joints]
        limits = robot.joint_limits
        self.axes = tuple(Axis("ABCDEFGH"[k], 1e6, limits, 0, n, robot.joint_unit) for k, n in enumerate(names))
        self.unit, self.speed, self.acceleration = robot.joint_unit, 1.0, 100.0
        self.arrived_within = 0.01 if robot.joint_unit == "mm" else 2e-4
        self.left_at = {}
        self.said, self.zeroed = said, 7
        self.body = np.array(start, dtype=float)
        self.slipped = np.zeros(len(start))
        self.encode = lambda at: at
        self.moves = 0

    def connect(self):
        return self

    def close(self):
        pass

    def identify(self):
        return Identity(self.kind, "dummy", self.address)

    def encoders(self):
        return self.encode(self.body + self.slipped)

    def read(self):
        names = tuple(a.label for a in self.axes)
        return Reading(self.name, names, tuple(map(float, self.encoders())), (self.unit,) * len(names), now_s())

    def reference(self):
        n = len(self.axes)
        at = tuple(map(float, self.encoders()))
        return AxisReference(self.said, self.zeroed if self.said else None, at, (True,) * n, (True,) * n)

    def set_reference(self, positions):
        self.slipped = np.array(positions) - self.body
        return self.reference()

    def home(self):
        raise NotImplementedError

    def check(self, target):
        return {a.letter: float(q) for a, q in zip(self.axes, target, strict=True)}

    def move(self, target):
        self.require_reference(limits=True)
        self.moves += 1
        # the loop is closed over what the encoders say
        self.body = self.body + (np.array(target, dtype=float) - self.encoders())
        reading = self.read()
        self.left_at = {a.letter: q for a, q in zip(self.axes, reading.values, strict=True)}
        return reading

    def is_moving(self):
        return False

    def stop(self):
        pass

    def enable(self):
        pass


class Eyes(Instrument):
    """Sees ``place(joints)`` with noise; ``spoil(values, step)`` is what becomes of it."""

    kind = "eyes"

    def __init__(self, robot, motors, place, noise, seed):
        super().__init__("dummy://eyes", name="eyes")
        self.layout = kind_of(robot).layout
        self.motors, self.place, self.noise = motors, place, noise
        self.random = np.random.default_rng(seed)
        self.spoil = lambda values: values
        self.late_s = 0.0
        self._last = None

    def connect(self):
        return self

    def close(self):
        pass

    def identify(self):
        return Identity(self.kind, "dummy", self.address)

    def read(self):
        # noise by place: two readings of it agree
        if self._last is None or not np.array_equal(self._last[0], self.motors.body):
            true = np.asarray(self.place(self.motors.body), dtype=float)
            seen = self.spoil(true + self.noise * self.random.normal(size=len(true)))
            self._last = (self.motors.body.copy(), seen)
        unit = self.layout.coordinates[0].rpartition("_")[2]
        values = tuple(map(float, self._last[1]))
        names = tuple(n.rpartition("_")[0] for n in self.layout.coordinates)
        return Reading(self.name, names, values, (unit,) * len(values), now_s() - self.late_s)


def dummy_bench(robot, place, start, *, noise=0.005, seed=0, said=True, **checks):
    """A bench of dummies around a robot that is at ``place(joints)``."""
    motors = Motors(robot, start, said)
    eyes = Eyes(robot, motors, place, noise, seed)
    unit = kind_of(robot).place_unit
    settings = {"agree_within": 0.05, "moved_within": 1e-4, "noise": {"mm": 0.05, "px": 0.5}[unit], **checks}
    return Bench(
        robot, motors, [Sensor(eyes, kind_of(robot).layout.coordinates)], settling=Settling(0.0),
        checks=Checks(**settings),
    )  # fmt: skip


# -- twenty faults: each is given the bench and puts something wrong from now on --------------------------------


def _spoiling(change):
    """A fault of what the eyes see, ``change(values, before, memory)`` of what they would have shown."""

    def fault(bench):
        memory = {}

        def spoil(values):
            out = np.array(change(np.array(values), memory), dtype=float)
            memory["last"] = np.array(values)
            return out

        eyes = bench.sensors[0].instrument
        eyes.spoil = spoil

    return fault


def _frozen(which):
    def change(values, memory):
        held = memory.setdefault("held", values.copy())
        values[which] = held[which]
        return values

    return change


def _lagging(which):
    def change(values, memory):
        last = memory.get("last", values)
        values[which] = last[which]
        return values

    return change


def _on(which, what):
    def change(values, memory):
        memory["n"] = memory.get("n", 0) + 1
        values[which] = what(values[which], memory["n"])
        return values

    return change


ALL = slice(None)


def faults(rng, n, unit, spread):
    """Twenty faults by name: instrument, and what to do to a bench. ``n`` columns that vary by about ``spread``."""
    k = int(rng.integers(n))
    j = int(rng.integers(2))
    step = 0.25 * spread * float(rng.choice([-1.0, 1.0]))
    slip = (2.0 if unit == "mm" else 0.02) * float(rng.choice([-1.0, 1.0]))
    # two of them: three taken round are a sensor that stands turned
    swap = np.array([1, 0, *range(2, n)])

    def slipping(by):
        def fault(bench):
            bench.motion.slipped = bench.motion.slipped + np.asarray(by(len(bench.motion.slipped)), dtype=float)
            # as left: the controller does not notice
            bench.motion.left_at = {}

        return fault

    def one(count):
        return slip * np.eye(count)[min(j, count - 1)]

    def encoding(change):
        def fault(bench):
            zero = bench.motion.body.copy()
            bench.motion.encode = lambda at: change(at, zero)
            bench.motion.left_at = {}

        return fault

    def counts_lost(at, zero):
        out = at.copy()
        out[j] = zero[j] + 1.1 * (at[j] - zero[j])
        return out

    def late(bench):
        bench.sensors[0].instrument.late_s = 30.0

    def early(bench):
        bench.sensors[0].instrument.late_s = -3600.0

    noisy = np.random.default_rng(int(rng.integers(1 << 30)))
    return {
        "one column frozen": ("eyes", _spoiling(_frozen([k]))),
        "all columns frozen": ("eyes", _spoiling(_frozen(ALL))),
        "one column lags by a pose": ("eyes", _spoiling(_lagging([k]))),
        "all columns lag by a pose": ("eyes", _spoiling(_lagging(ALL))),
        "one sign turned": ("eyes", _spoiling(_on([k], lambda v, _: -v))),
        "all signs turned": ("eyes", _spoiling(_on(ALL, lambda v, _: -v))),
        "columns swapped": ("eyes", _spoiling(lambda v, _: v[swap])),
        "one column shifts": ("eyes", _spoiling(_on([k], lambda v, _: v + step))),
        "all columns shift": ("eyes", _spoiling(_on(ALL, lambda v, _: v + step))),
        "a gain changes": ("eyes", _spoiling(_on([k], lambda v, _: 1.5 * v))),
        "another unit": ("eyes", _spoiling(_on(ALL, lambda v, _: 1e-3 * v))),
        "stuck at zero": ("eyes", _spoiling(_on([k], lambda v, _: 0.0 * v))),
        "noise explodes": ("eyes", _spoiling(_on(ALL, lambda v, _: v + 0.2 * spread * noisy.normal(size=n)))),
        "one column runs away": ("eyes", _spoiling(_on([k], lambda v, i: v + 0.08 * spread * i))),
        "read in coarse steps": ("eyes", _spoiling(_on(ALL, lambda v, _: spread * np.round(v / spread)))),
        "an old reading": ("eyes", late),
        "a clock that goes back and forth": ("eyes", early),
        "an encoder slipped": ("motors", slipping(one)),
        "all encoders slipped": ("motors", slipping(lambda c: np.full(c, slip))),
        "an encoder loses counts": ("motors", encoding(counts_lost)),
    }
