"""Every parser of replies on random and mutated bytes: a typed error or a right value, nothing else, and no hang."""

from __future__ import annotations

import math
import random
import struct

import numpy as np
import pytest

from sherkit.errors import InstrumentError
from sherkit.lab.instruments import ati, camera, galil_line, keyence, micron_optics, scpi

FAST = 20_000
SLOW = 1_000_000


def sm130():
    header = bytearray(88)
    struct.pack_into("<H", header, 16, 2)
    struct.pack_into("<H", header, 20, 1)
    struct.pack_into("<III", header, 28, 7, 250_000, 12)
    struct.pack_into("<H", header, 50, 88)
    struct.pack_into("<I", header, 72, 1_000_000)
    struct.pack_into("<II", header, 80, 1_510_000_000, 1_590_000_000)
    return bytes(header) + struct.pack("<3I", 1_540_000_000, 1_550_000_001, 1_560_000_000)


def hyperion():
    return struct.pack("<HBBIQII4h3d", 32, 0, 1, 0, 9, 12, 500, 2, 0, 1, 0, 1540.0, 1550.5, 1560.0)


def numbers_are_right(values, data):
    # by the rule of the documents, in another way: spaces and commas part, each word is what float says
    words = data.decode("latin-1").replace(",", " ").split(" ")
    assert list(values) == [float(w) for w in words if w]
    assert all(math.isfinite(v) for v in values)


def scpi_is_right(values, data):
    # each word between commas is what float says, and nothing that SCPI calls infinite
    assert list(values) == [float(word) for word in data.decode("ascii").strip().split(",")]
    assert all(abs(v) < 9.9e37 for v in values)


def answer_is_right(text, data):
    low = bytes(b for b in data if b < 0x80)
    assert low in (b":", text.encode() + b"\r\n:")


def refusal_is_right(found, data):
    digits = data.decode("latin-1").lstrip(" ")[:3]
    assert digits[0].isdigit()
    assert any(digits[:n].isdigit() and int(digits[:n]) == found[0] for n in (1, 2, 3))


def reply_is_right(fields, data):
    assert data == ",".join(("MS", "01", *fields)).encode() + b"\r"


def value_is_right(value, data):
    assert (data == b"XXXXXXXX" and math.isnan(value)) or (
        len(data) == 8 and data[:1] in b"+-" and value == float(data) and abs(value) < 1e7
    )


def length_is_right(length, data):
    assert length == int(data.strip(b" \0"))


def hyperion_header_is_right(found, data):
    assert struct.unpack("<BBHI", data)[::2][:1] == found[:1]


def peaks_are_right(peaks, data):
    raw = [v for channel in peaks.channels_nm for v in channel]
    assert len(peaks.channels_nm) == 4
    assert len(data) == 88 + 4 * len(raw)
    granularity = struct.unpack_from("<I", data, 72)[0]
    assert raw == [v / granularity for v in struct.unpack(f"<{len(raw)}I", data[88:])]
    assert [len(c) for c in peaks.channels_nm] == list(struct.unpack_from("<4H", data, 16))


def hyperion_peaks_are_right(peaks, data):
    raw = [v for channel in peaks.channels_nm for v in channel]
    size = struct.unpack_from("<H", data)[0]
    assert raw == list(struct.unpack(f"<{len(raw)}d", data[size:]))
    assert all(100.0 <= v <= 10000.0 for v in raw)
    assert [len(c) for c in peaks.channels_nm] == list(struct.unpack(f"<{(size - 24) // 2}h", data[24:size]))


def record_is_right(record, data):
    assert struct.pack(">III6i", record.sequence, record.sample, record.status, *record.counts) == data


def scale_is_right(scale, data):
    assert 0 < scale.counts_per_force < math.inf
    assert 0 < scale.counts_per_torque < math.inf
    assert str(data).count("cfgcpf") >= 1


#: What to call, replies as they should be, and what must hold for a value that is returned.
PARSERS = {
    "galil answer": (
        galil_line.parse_answer,
        [b":", b"?", b" 200.0000\r\n:", b" 200, -10, 0\r\n:", b" 2\xc8\xc9\xba\x8d\x8a00.0000 1.0000\r\n:"],
        answer_is_right,
    ),
    "galil numbers": (
        lambda data: galil_line.parse_galil_numbers(data.decode("latin-1"), 3),
        [b" 200, -10, 0", b" 200.0000 -10.0000 0.0000", b" 1,2,3"],
        numbers_are_right,
    ),
    "galil counts": (
        lambda data: galil_line.parse_counts(data.decode("latin-1"), 2),
        [b" 200, -10", b" 2147483647.0000 -2147483648.0000"],
        numbers_are_right,
    ),
    "galil refusal": (
        lambda data: galil_line.parse_refusal(data.decode("latin-1")),
        [b"1 Unrecognized command", b"22 Begin not possible due to Limit Switch", b"6 Number out of range"],
        refusal_is_right,
    ),
    "keyence reply": (
        lambda data: keyence.parse_reply(data, "MS,01"),
        [b"MS,01,+000.073\r", b"ER,MS,22\r", b"MS,01,XXXXXXXX\r", b"MS,01\r"],
        reply_is_right,
    ),
    "keyence value": (
        lambda data: keyence.parse_value(data.decode("latin-1")),
        [b"+000.073", b"-12.3456", b"+FFFFFFF", b"XXXXXXXX"],
        value_is_right,
    ),
    "scpi numbers": (
        lambda data: scpi.parse_numbers(data),
        [b"+1.23456789E+00,-2.5,3\n", b"+9.90000000E+37\n", b"+9.91000000E+37,1\n"],
        scpi_is_right,
    ),
    "sm130 length": (
        micron_optics.parse_length,
        [b"0000000100", b"       100", b"100       "],
        length_is_right,
    ),
    "sm130 peaks": (micron_optics.parse_peaks, [sm130(), sm130()[:88]], peaks_are_right),
    "hyperion header": (
        micron_optics.parse_hyperion_header,
        [struct.pack("<BBHI", 0, 0, 12, 400), struct.pack("<BBHI", 1, 0, 0, 0)],
        hyperion_header_is_right,
    ),
    "hyperion peaks": (micron_optics.parse_hyperion_peaks, [hyperion(), hyperion()[:24]], hyperion_peaks_are_right),
    "ati record": (
        ati.parse_record,
        [struct.pack(">III6i", 1, 2, 0, 1_000_000, -2, 3, 4, 5, -6)],
        record_is_right,
    ),
    "ati scale": (
        ati.parse_scale,
        [
            b"<?xml version='1.0'?><netft><cfgcpf>1000000</cfgcpf><cfgcpt>1e6</cfgcpt><scfgfu>N</scfgfu></netft>",
            b"<netft><cfgcpf>12</cfgcpf><cfgcpt>3</cfgcpt></netft>",
        ],
        scale_is_right,
    ),
}


def mutated(rng, seeds):
    """A reply of the right form with something wrong in it, or nothing but noise."""
    if rng.random() < 0.1:
        return rng.randbytes(rng.randrange(120))
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.randrange(4)):
        at = rng.randrange(len(data) + 1)
        how = rng.randrange(6)
        if how == 0:
            data[at:at] = rng.randbytes(rng.randrange(1, 5))
        elif how == 1:
            del data[at : at + rng.randrange(1, 6)]
        elif how == 2 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif how == 3 and at < len(data):
            # the characters that replies are made of do more harm than others
            data[at] = rng.choice(b"0123456789+-.,: ?\r\nFXMSAER")
        elif how == 4:
            data += rng.choice(seeds)[at:]
        elif how == 5 and at < len(data):
            # numbers at their ends
            end = rng.choice((b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\x7f", b"\0\0\xf8\x7f"))
            data[at : at + len(end)] = end
    return bytes(data)


def fuzz(name, count, seed):
    parse, seeds, right = PARSERS[name]
    rng = random.Random(f"{name} {seed}")
    values = errors = 0
    for seed_bytes in seeds:
        try:
            right(parse(seed_bytes), seed_bytes)
        except InstrumentError:
            continue
    for _ in range(count):
        data = mutated(rng, seeds)
        try:
            value = parse(data)
        except InstrumentError as error:
            errors += 1
            # its sentence can be made, whatever the bytes are
            said = str(error) if errors % 100 == 0 else "not looked at"
        else:
            said = ""
        if said:
            continue
        values += 1
        right(value, data)
    assert values
    assert errors
    return values, errors


@pytest.mark.parametrize("name", PARSERS)
def test_parsers_give_a_right_value_or_a_typed_error(name):
    """Catches another exception than InstrumentError, and a value that the bytes do not say."""
    fuzz(name, FAST, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", PARSERS)
def test_parsers_over_a_million_inputs(name):
    """Catches what the short test does, where it is rare."""
    values, errors = fuzz(name, SLOW, 1)
    print(f"{name}: {values} right values, {errors} typed errors")


def test_frames_that_are_none_are_refused():
    """Catches a picture of another type or shape that breaks whoever looks at it."""
    rng = random.Random(0)
    types = (np.uint8, np.uint16, np.float64, np.bool_, object)
    for _ in range(FAST):
        shape = tuple(rng.randrange(5) for _ in range(rng.randrange(5)))
        given = rng.choice((None, 3, "x", b"abc", [1, 2], np.zeros(shape, rng.choice(types))))
        size = rng.choice((None, (4, 3), (3, 4)))
        ok = rng.random() < 0.9
        try:
            picture = camera.parse_frame(ok, given, size)
        except InstrumentError:
            continue
        assert ok
        assert picture is given
        assert picture.dtype == np.uint8
        assert picture.ndim in (2, 3)
        assert size is None or (picture.shape[1], picture.shape[0]) == size
