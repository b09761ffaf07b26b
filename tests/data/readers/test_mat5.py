"""MATLAB files: the same content as SciPy reads, and one sentence for every damaged byte."""

import contextlib
import struct

import numpy as np
import pytest
from scipy.io import savemat

from slipangle.data.readers import read
from slipangle.data.readers.mat5 import read_mat5
from slipangle.errors import FormatError

CONTENT = {
    "SA": np.linspace(-12, 12, 50)[:, None],
    "matrix": np.arange(12.0).reshape(3, 4),
    "cube": np.arange(24, dtype=np.int16).reshape(2, 3, 4),
    "flags": np.array([[True, False]]),
    "single": np.float32(2.5),
    "text": "Calspan run 7 µ",
    "rows": np.array(["ab", "cde"]),
    "empty": np.empty((0, 0)),
    "cell": np.array(["deg", np.arange(3.0), "N"], dtype=object),
    "channel": {"name": np.array(["SA", "FZ"], dtype=object), "units": np.array(["deg", "N"], dtype=object)},
}


@pytest.mark.parametrize("compressed", [False, True])
def test_content_is_what_was_written(tmp_path, compressed):
    savemat(tmp_path / "a.mat", CONTENT, do_compression=compressed)
    found = read_mat5(tmp_path / "a.mat")
    for name in ("SA", "matrix", "cube", "flags"):
        assert found[name].shape == CONTENT[name].shape
        assert np.array_equal(found[name], CONTENT[name])
    assert found["single"].item() == 2.5
    assert found["text"] == CONTENT["text"]
    assert list(found["rows"]) == ["ab", "cde"]
    assert found["empty"].size == 0
    assert found["cell"][0] == "deg"
    assert np.array_equal(found["cell"][1].ravel(), np.arange(3.0))
    assert list(found["channel"]["units"][0]) == ["deg", "N"]


def test_other_kinds_are_left_out(tmp_path):
    from scipy.sparse import csc_array

    savemat(tmp_path / "a.mat", {"s": csc_array((10**5, 10**5)), "x": np.ones((2, 1))})
    assert list(read_mat5(tmp_path / "a.mat")) == ["x"]


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "not a MATLAB file"),
        (b"x" * 200, "not a MATLAB file"),
        (b"\x89HDF\r\n\x1a\n" + b"x" * 600, r"MATLAB 7.3 file; .*save\(\.\.\., '-v7'\)"),
        (b" " * 512 + b"\x89HDF\r\n\x1a\n" + b"x" * 90, "MATLAB 7.3"),
    ],
)
def test_other_files(tmp_path, raw, message):
    (tmp_path / "a.mat").write_bytes(raw)
    with pytest.raises(FormatError, match=message):
        read_mat5(tmp_path / "a.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_cut_files_say_so(tmp_path, compressed):
    savemat(tmp_path / "a.mat", {"x": np.random.default_rng(0).normal(size=500)}, do_compression=compressed)
    raw = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(raw[: len(raw) - 100])
    with pytest.raises(FormatError, match=r"damaged after 0 variables \(an element is longer than the file\)"):
        read_mat5(tmp_path / "a.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_no_byte_can_break_it(tmp_path, compressed):
    file = tmp_path / "a.mat"
    savemat(file, CONTENT, do_compression=compressed)
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        raw = bytearray(whole)
        for at in rng.integers(120, len(raw), rng.integers(1, 8)):
            raw[at] = rng.integers(0, 256)
        file.write_bytes(bytes(raw))
        with contextlib.suppress(FormatError):
            read_mat5(file)


def test_words_without_letters_in_countless_rows_take_no_time(tmp_path):
    path = tmp_path / "x.mat"
    savemat(path, {"x": "", "y": [1.0, 2.0]})
    raw, empty = path.read_bytes(), struct.pack("<4i", 5, 8, 0, 0)  # two numbers of a shape: none by none
    assert raw.count(empty) == 1
    path.write_bytes(raw.replace(empty, struct.pack("<4i", 5, 8, 2**31 - 1, 0)))
    found = read_mat5(path)
    assert found["x"] == ""
    np.testing.assert_array_equal(found["y"].ravel(), [1, 2])


def turning(n=40):
    return 0.01 * np.arange(n), np.exp(1j * np.arange(n))


@pytest.mark.parametrize("compressed", [False, True])
def test_of_a_complex_vector_the_real_part_is_read_with_a_note(tmp_path, compressed):
    t, c = turning()
    content = {"t": t, "c": c, "w": np.arange(40.0), "s": {"z": 2j * c}}
    savemat(tmp_path / "a.mat", content, do_compression=compressed)
    data = read(tmp_path / "a.mat", {"q": "c", "w": "w", "z": "s.z"})
    np.testing.assert_array_equal(data["q"], c.real)
    np.testing.assert_array_equal(data["z"], (2j * c).real)
    said = [note for note in data.notes if "is complex: only its real part is read" in note]
    assert [note.split("'")[1] for note in said] == ["c", "s.z"]


def test_complex_numbers_without_an_imaginary_part_are_real(tmp_path):
    t, c = turning()
    savemat(tmp_path / "a.mat", {"t": t, "c": c.real.astype(complex)})
    data = read(tmp_path / "a.mat", {"q": "c"})
    np.testing.assert_array_equal(data["q"], c.real)
    assert not any("complex" in note for note in data.notes)


def test_of_a_complex_vector_in_hdf5_too(tmp_path):
    h5py = pytest.importorskip("h5py")
    t, c = turning()
    with h5py.File(tmp_path / "a.mat", "w") as file:
        kind = [("real", "f8"), ("imag", "f8")]
        for name, values in {"t": t, "c": np.array(list(zip(c.real, c.imag, strict=True)), dtype=kind)}.items():
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    data = read(tmp_path / "a.mat", {"q": "c"})
    np.testing.assert_array_equal(data["q"], c.real)
    assert sum("'c' is complex" in note for note in data.notes) == 1


def hdf5_of(path, attributes):
    """Read 72 as v_x of an HDF5 file whose dataset has these attributes."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["time"], file["v_x"] = 0.01 * np.arange(50), np.full(50, 72.0)
        file["time"].attrs["units"] = "seconds since 2024-05-01 00:00:00"
        for name, value in attributes.items():
            file["v_x"].attrs[name] = value
    return read(path, {"v_x": "v_x"})


@pytest.mark.parametrize(
    ("attributes", "si"),
    [
        ({"units": "km/h"}, 20.0),
        ({"unit": np.bytes_("km/h")}, 20.0),
        ({"Units": np.array(["km/h"], dtype="S")}, 20.0),
        ({"long_name": "speed", "UNITS": "mph"}, 72 * 0.44704),
        ({"units": "m s-1"}, 72.0),
    ],
)
def test_a_unit_in_the_attributes_of_an_hdf5_dataset_is_its_unit(attributes, si, tmp_path):
    data = hdf5_of(tmp_path / "a.h5", attributes)
    np.testing.assert_allclose(data["v_x"], si, rtol=1e-12)
    assert not any("no unit" in note for note in data.notes)


@pytest.mark.parametrize("attributes", [{}, {"units": ""}, {"units": 3.0}, {"units": np.zeros(0)}])
def test_an_hdf5_dataset_without_a_unit_is_taken_as_si(attributes, tmp_path):
    data = hdf5_of(tmp_path / "a.h5", attributes)
    assert data["v_x"][0] == 72.0
    assert "no unit named for v_x: taken as SI" in data.notes
