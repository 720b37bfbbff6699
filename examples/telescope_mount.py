"""Diagnosis of machines that are no deltas: two-axis telescope mounts, pointed at stars of known direction.

    python examples/telescope_mount.py [folder of the pointing runs]

A mount has two encoders. A pointing run compares where they say the tube looks with where the star is. The six
geometric terms below are the field's own (P. T. Wallace, TPOINT): the model is theirs, the diagnosis is sherkit's.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
from numpy.typing import NDArray

import sherkit as sk

Floats = NDArray[np.float64]

DATA = Path(__file__).parents[1] / "tests" / "data"
GEM = Path("gem_mount_pointing") / "gem_pointing.csv"
MMT = Path("mmt_pointing") / "mmt_pointing.csv"


def angles(rows: sk.Measurements) -> SimpleNamespace:
    """Sines and cosines of hour angle h, declination d and the pole's elevation φ, and the side of the pier ±1."""
    h, d, pole = np.deg2rad(rows["hour_angle_deg"]), np.deg2rad(rows["declination_deg"]), np.deg2rad(rows["pole_deg"])
    return SimpleNamespace(
        sh=np.sin(h), ch=np.cos(h), sd=np.sin(d), cd=np.cos(d), sp=np.sin(pole), cp=np.cos(pole), side=rows["side"]
    )  # fmt: skip


def on_sky(across: Floats, along: Floats) -> Floats:
    """Errors (n, 2): along the parallel, which is Δh cos d, and along the meridian."""
    return np.column_stack(np.broadcast_arrays(across, along))


# What no geometric term holds. Each is one function that adds to the readings; diagnosis tries them all.


@sk.effect(at="sensor", parameters={"TF": ("arcsec", 1000.0)})
def tube_flexure(rows, p):
    """The tube sags towards the ground by TF times the sine of the zenith distance."""
    a = angles(rows)
    return p.TF * on_sky(a.cp * a.sh, a.cp * a.ch * a.sd - a.sp * a.cd)


@sk.effect(at="sensor", parameters={"FO": ("arcsec", 1000.0)})
def fork_flexure(rows, p):
    """The fork, or the mount under it, gives way with the hour angle."""
    a = angles(rows)
    return p.FO * on_sky(0.0 * a.ch, a.ch)


@sk.effect(at="sensor", parameters={"DAF": ("arcsec", 1000.0)})
def axis_flexure(rows, p):
    """The declination axis, loaded at its end, bends."""
    a = angles(rows)
    return p.DAF * on_sky(-a.side * (a.cp * a.ch * a.cd + a.sp * a.sd), 0.0 * a.ch)


@sk.effect(at="sensor", parameters={"HCES": ("arcsec", 1000.0), "HCEC": ("arcsec", 1000.0)})
def polar_circle(rows, p):
    """The encoder circle of the first axis sits off its centre."""
    a = angles(rows)
    return on_sky((p.HCES * a.sh + p.HCEC * a.ch) * a.cd, 0.0 * a.ch)


@sk.effect(at="sensor", parameters={"DCES": ("arcsec", 1000.0), "DCEC": ("arcsec", 1000.0)})
def declination_circle(rows, p):
    """The encoder circle of the second axis sits off its centre."""
    a = angles(rows)
    return on_sky(0.0 * a.ch, p.DCES * a.sd * a.side + p.DCEC * a.cd)


@dataclass(frozen=True)
class Mount:
    """The six geometric terms, arcsec: index errors IH and ID, collimation CH, axes not at right angles NP, and a
    polar axis that is off by MA sideways and ME in elevation. The mount turned over the pole flips three of them."""

    terms = ("IH", "ID", "CH", "NP", "MA", "ME")
    parameters = tuple(sk.model.Parameter(name, name, "arcsec", 3600.0) for name in terms)
    candidates = (tube_flexure, fork_flexure, axis_flexure, polar_circle, declination_circle)

    def predict(self, data: sk.Measurements, values: Floats) -> Floats:
        """Mount minus star (n, 2), arcsec."""
        return self.derivatives(data, values) @ values

    def derivatives(self, data: sk.Measurements, values: Floats) -> Floats:
        """Derivatives (n, 2, 6); the terms are linear."""
        a, zero = angles(data), np.zeros(len(data))
        columns = (
            on_sky(a.cd, zero), on_sky(zero, a.side), on_sky(a.side, zero), on_sky(a.side * a.sd, zero),
            on_sky(-a.ch * a.sd, a.sh), on_sky(a.sh * a.sd, a.ch),
        )  # fmt: skip
        return np.stack(columns, axis=2)

    def covariates(self, data: sk.Measurements) -> dict[str, Floats]:
        """What else the error may depend on: the side of the pier."""
        return {"side": data["side"]}


def wrapped(degrees: Floats) -> Floats:
    """An angle in (-180, 180]."""
    return 180.0 - np.mod(180.0 - degrees, 360.0)


def pointing_run(
    source: str, h: Floats, d: Floats, off: tuple[Floats, Floats], side: Floats, pole: Floats
) -> sk.Measurements:
    """The rows of one run: directions of the stars, and by how much the mount is off (Δh, Δd); all in degrees."""
    readings = 3600.0 * on_sky(off[0] * np.cos(np.deg2rad(d)), off[1])
    return sk.data.from_arrays(
        place={"hour_angle_deg": h, "declination_deg": d},
        readings=readings,
        names=("parallel", "meridian"),
        unit="arcsec",
        covariates={"side": side, "pole_deg": pole},
        block=np.arange(len(h)),  # single stars are held out; without this line, tiles of the sky
        source=source,
    )


def read_gem(file: Path, run: str) -> sk.Measurements:
    """A run of a German equatorial mount. A declination reading above 90° says that it is turned over the pole.

    In gem-28, 19 rows read below -150° instead: turned over too, and off by a full turn of the circle. They are left
    as the file has them, for the diagnosis to find.
    """
    t = pl.read_csv(file).filter(pl.col("file") == run)
    h_star, d_star = wrapped((t["lst_deg"] - t["ra_cat_deg"]).to_numpy()), t["dec_cat_deg"].to_numpy()
    circle = t["dec_mount_deg(>90=flipped)"].to_numpy()
    over = circle > 90.0
    h = (t["lst_deg"] - t["ra_mount_deg"]).to_numpy() - 180.0 * over
    d = np.where(over, 180.0 - circle, circle)
    off = wrapped(h - h_star), d - d_star
    return pointing_run(run, h_star, d_star, off, np.where(over, -1.0, 1.0), t["latitude_deg"].to_numpy())


def read_mmt(file: Path, run: str, encoder: str = "raw") -> sk.Measurements:
    """A night of an altazimuth telescope: its pole is the zenith, azimuth is its hour angle, elevation its
    declination. ``encoder`` is ``raw``, or ``abs``, which the telescope's own pointing model has corrected."""
    t = pl.read_csv(file).filter(pl.col("file") == run)
    azimuth, elevation = t["az_calc_deg"].to_numpy(), t["el_calc_deg"].to_numpy()
    off = wrapped(t[f"az_{encoder}_deg"].to_numpy() - azimuth), t[f"el_{encoder}_deg"].to_numpy() - elevation
    return pointing_run(run, wrapped(azimuth), elevation, off, np.ones(len(t)), np.full(len(t), 90.0))


def diagnosed(rows: sk.Measurements) -> sk.diagnosis.Diagnosis:
    """What the six terms miss."""
    return sk.diagnose(sk.identify(Mount(), rows))


def main() -> None:
    """Prints, for every run, the verdict and how the error on directions held out falls."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    if not (folder / GEM).exists() or not (folder / MMT).exists():
        print(f"skipped: no pointing runs in {folder} (looked for {GEM} and {MMT})")
        return
    runs = [read_gem(folder / GEM, "gem-28.dat")]
    runs += [read_mmt(folder / MMT, f"point_{night}.dat") for night in ("20230702", "20230924")]
    for rows in runs:
        d = diagnosed(rows)
        print(f"{rows.source}: {len(rows)} stars, {len(d.outliers)} of them outliers: {d.verdict}")
        for step in d.steps:
            name = "six geometric terms" if step.effect is None else f"+ {step.effect}"
            print(f"    {name:<24}{step.error.rms:10.2f}″ held out")
        for c in d.candidates:
            if c.effect not in d.effects:
                print(f"    (with {c.effect + ' alone':<29}{c.held_out_rms:7.2f}″)")
        for p in (p for c in d.candidates if c.effect in d.effects for p in c.parameters):
            print(f"    {p['name']} = {p['value']:.0f} ± {p['std']:.0f} {p['unit']}")
        if d.signature:
            print(f"    left: {sk.diagnosis.sentence(d.signature)}")


if __name__ == "__main__":
    main()
