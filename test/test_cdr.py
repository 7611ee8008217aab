"""CDR against rclpy (little endian) and rosbags (big endian) as oracles; laws by hypothesis; hostile bytes."""

from __future__ import annotations

import struct
import warnings
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from streams import accel_stamped

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import cdr

STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
FLOATS = st.floats(width=64)
FRAMES = st.one_of(
    st.text(st.characters(blacklist_characters="\0", blacklist_categories=("Cs",)), max_size=40), st.just("f" * 4000)
)
SAMPLES = st.tuples(STAMPS, st.tuples(*[FLOATS] * 6), FRAMES)


def imu_bytes(stamp_ns: int, values: tuple[float, ...], frame_id: str, order: str = "<") -> bytes:
    """An Imu message built field by field by the format, independent of the code under test."""
    frame = frame_id.encode() + b"\0"
    out = b"\x00\x01\x00\x00" if order == "<" else b"\x00\x00\x00\x00"
    body = struct.pack(f"{order}iII", *divmod(stamp_ns, 10**9), len(frame)) + frame
    body += b"\xaa" * (-len(body) % 8)  # writers leave rubbish in their padding
    numbers = (0.0, 0.0, 0.0, 1.0, *[7.0] * 9, *values[3:], *[8.0] * 9, *values[:3], *[9.0] * 9)
    return out + body + struct.pack(f"{order}37d", *numbers)


def assert_decodes(block: cdr.ImuBlock, samples: list[tuple[int, tuple[float, ...], str]]) -> None:
    values = np.array([v for _, v, _ in samples]).reshape(-1, 6)
    assert block.stamps_ns.dtype == np.int64
    assert block.stamps_ns.tolist() == [stamp for stamp, _, _ in samples]
    np.testing.assert_array_equal(block.accel_mps2, values[:, :3])
    np.testing.assert_array_equal(block.gyro_radps, values[:, 3:])


@given(st.lists(st.tuples(SAMPLES, st.sampled_from("<>")), max_size=8))
def test_any_mixture_of_frames_and_byte_orders_decodes_in_order(items):
    samples = [sample for sample, _ in items]
    assert_decodes(cdr.decode_imu([imu_bytes(*sample, order) for sample, order in items], gyro=True), samples)


@given(SAMPLES, st.sampled_from("<>"))
def test_one_message_decodes_as_in_a_block(sample, order):
    stamp_ns, accel = cdr.decode_imu_one(imu_bytes(*sample, order))
    assert stamp_ns == sample[0]
    np.testing.assert_array_equal(accel, sample[1][:3])


@given(st.lists(SAMPLES, min_size=1, max_size=6), FRAMES)
def test_encode_then_decode_is_the_identity(samples, frame_id):
    values = np.array([v for _, v, _ in samples])
    stamps = np.array([stamp for stamp, _, _ in samples], dtype=np.int64)
    encoded = cdr.encode_imu(stamps, values[:, :3], values[:, 3:], frame_id)
    messages = [row.tobytes() for row in encoded]
    assert_decodes(cdr.decode_imu(messages, gyro=True), samples)
    frame = frame_id.encode() + b"\0"
    assert {message[12 : 16 + len(frame)] for message in messages} == {struct.pack("<I", len(frame)) + frame}
    assert_decodes(
        cdr.decode_imu_in(
            encoded.ravel(), np.arange(len(encoded)) * encoded.shape[1], np.full(len(encoded), encoded.shape[1]), True
        ),
        samples,
    )


def test_gaps_and_disorder_in_the_buffer_are_followed():
    a, b = imu_bytes(1, (1, 2, 3, 4, 5, 6), "a"), imu_bytes(2, (7, 8, 9, 10, 11, 12), "longer frame")
    buffer = np.frombuffer(b"??" + b + b"???" + a, dtype=np.uint8)
    block = cdr.decode_imu_in(buffer, np.array([5 + len(b), 2]), np.array([len(a), len(b)]), gyro=True)
    assert_decodes(block, [(1, (1, 2, 3, 4, 5, 6), "a"), (2, (7, 8, 9, 10, 11, 12), "longer frame")])


def test_no_messages_are_an_empty_block():
    block = cdr.decode_imu([], gyro=True)
    assert (len(block), block.accel_mps2.shape, block.gyro_radps.shape) == (0, (0, 3), (0, 3))


def test_angular_velocity_is_decoded_on_request_alone():
    assert cdr.decode_imu([imu_bytes(1, (1, 2, 3, 4, 5, 6), "imu")]).gyro_radps is None
    assert cdr.decode_imu([]).gyro_radps is None


def test_a_covariance_of_minus_one_means_no_gyro():
    """REP-145: -1 in the first element alone, and only for that message."""
    messages = [bytearray(imu_bytes(n, (1, 2, 3, 4, 5, n), "imu", order)) for n, order in enumerate("<><")]
    for n, order, element in ((0, "<", 0), (1, ">", 0), (2, "<", 1)):
        struct.pack_into(f"{order}d", messages[n], len(messages[n]) - 296 + 128 + 8 * element, -1.0)
    block = cdr.decode_imu([bytes(message) for message in messages], gyro=True)
    assert np.isnan(block.gyro_radps[:2]).all()
    assert block.gyro_radps[2].tolist() == [4.0, 5.0, 2.0]
    assert block.accel_mps2.tolist() == [[1.0, 2.0, 3.0]] * 3


def test_a_covariance_of_minus_one_means_no_acceleration():
    """Imu.msg: disregard the estimate; the sample then counts as one that is not finite."""
    messages = [bytearray(imu_bytes(n, (1, 2, 3, 4, 5, n), "imu", order)) for n, order in enumerate("<><")]
    for n, order, element in ((0, "<", 0), (1, ">", 0), (2, "<", 1)):
        struct.pack_into(f"{order}d", messages[n], len(messages[n]) - 296 + 224 + 8 * element, -1.0)
    given = [bytes(message) for message in messages]
    many = cdr.decode_imu(given * cdr.FEW).accel_mps2[:3]
    for accel in (many, cdr.decode_imu(given).accel_mps2, cdr.decode_imu(given, gyro=True).accel_mps2):
        assert np.isnan(accel[:2]).all() and accel[2].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("cut", [0, 1, 3, 4, 12, 15, 16, 100, 200, 250, 319, 323])
def test_a_cut_message_is_refused(cut):
    whole = imu_bytes(5, (1, 2, 3, 4, 5, 6), "imu_pelvis")
    assert len(whole) == 324
    for decode in (lambda m: cdr.decode_imu([whole, m]), cdr.decode_imu_one):
        with pytest.raises(InputError, match=r"cut or not a sensor_msgs/msg/Imu"):
            decode(whole[:cut])


@pytest.mark.parametrize("length", [0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 1000, 13])
@pytest.mark.parametrize("order", ["<", ">"])
def test_an_invalid_frame_length_is_refused(length, order):
    message = bytearray(imu_bytes(5, (1, 2, 3, 4, 5, 6), "imu", order))
    message[12:16] = struct.pack(f"{order}I", length)
    # 13 bytes exist, but the numbers of an Imu do not fit behind them: reading the stamp alone does not need them.
    for decode in (lambda m: cdr.decode_imu([m]), cdr.decode_imu_one, *([cdr.stamp_of] if length > 13 else [])):
        with pytest.raises(InputError, match=rf"frame_id of {length}"):
            decode(bytes(message))


def test_a_frame_length_of_zero_is_an_empty_frame():
    message = imu_bytes(5, (1, 2, 3, 4, 5, 6), "")
    bare = message[:12] + struct.pack("<I", 0) + bytes(4) + message[-296:]
    assert cdr.decode_imu_one(bare) == (5, (1.0, 2.0, 3.0))
    assert_decodes(cdr.decode_imu([bare], gyro=True), [(5, (1, 2, 3, 4, 5, 6), "")])
    assert cdr.stamp_of(bare) == 5


@pytest.mark.parametrize(("offset", "length"), [(-1, 324), (1, 324), (2**62, 324), (0, 2**62), (0, -5), (0, 2**63 - 1)])
def test_messages_outside_the_buffer_are_refused(offset, length):
    buffer = np.frombuffer(imu_bytes(5, (1, 2, 3, 4, 5, 6), "imu_pelvis"), dtype=np.uint8)
    with pytest.raises(InputError, match="exceed a buffer"):
        cdr.decode_imu_in(buffer, np.array([offset]), np.array([length]))


def test_an_encapsulation_that_is_not_plain_cdr_is_refused():
    message = b"\x00\x07" + imu_bytes(5, (1, 2, 3, 4, 5, 6), "imu")[2:]
    for decode in (lambda m: cdr.decode_imu([m]), cdr.decode_imu_one, cdr.stamp_of):
        with pytest.raises(InputError, match="encapsulation 00 07"):
            decode(message)


@given(st.binary(max_size=400))
def test_arbitrary_bytes_decode_or_are_refused(data):
    for decode in (cdr.decode_imu_one, cdr.stamp_of, lambda m: cdr.decode_imu([m]), lambda m: cdr.shift_stamp(m, 1)):
        with suppress(InputError):
            decode(data)


@given(STAMPS, FLOATS, FRAMES)
def test_the_template_is_one_row_of_the_encoder(stamp_ns, vertical, frame_id):
    expected = cdr.encode_accel_stamped(np.array([stamp_ns]), np.array([vertical]), frame_id)
    message = cdr.AccelStampedTemplate(frame_id).fill(stamp_ns, vertical)
    assert type(message) is bytes
    assert message == expected.tobytes()
    stamps, linear = accel_stamped([message])
    assert stamps.tolist() == [stamp_ns]
    np.testing.assert_array_equal(linear, [[0.0, 0.0, vertical]])


@given(SAMPLES, STAMPS, st.sampled_from("<>"))
def test_restamp_changes_the_stamp_alone(sample, stamp_ns, order):
    _, values, frame_id = sample
    moved = imu_bytes(stamp_ns, values, frame_id, order)
    assert cdr.restamp(imu_bytes(*sample, order), stamp_ns) == moved
    shifted = cdr.shift_stamp(imu_bytes(*sample, order), stamp_ns - sample[0])
    assert shifted == (moved if sample[0] != 0 else imu_bytes(*sample, order))


def test_an_unset_stamp_stays_unset_when_shifted():
    message = imu_bytes(0, (0.0,) * 6, "imu", "<")
    assert cdr.shift_stamp(message, 1_767_225_600 * 10**9) == message


@pytest.mark.parametrize("stamp_ns", [2**31 * 10**9, -(2**31) * 10**9 - 1, 2**80])
def test_a_stamp_that_ros_cannot_hold_is_refused(stamp_ns):
    with pytest.raises(InputError, match="does not fit a ROS stamp"):
        cdr.AccelStampedTemplate("f").fill(stamp_ns, 0.0)
    with pytest.raises(InputError, match="does not fit a ROS stamp"):
        cdr.restamp(imu_bytes(5, (1, 2, 3, 4, 5, 6), "imu"), stamp_ns)
    if abs(stamp_ns) < 2**63:
        with pytest.raises(InputError, match="does not fit a ROS stamp"):
            cdr.encode_accel_stamped(np.array([0, stamp_ns]), np.zeros(2), "f")


def test_arrays_that_do_not_fit_are_refused():
    stamps, vectors = np.arange(3), np.zeros((3, 3))
    with pytest.raises(InputError, match="accel_mps2 has shape"):
        cdr.encode_imu(stamps, np.zeros((2, 3)), vectors, "f")
    with pytest.raises(InputError, match="gyro_radps has shape"):
        cdr.encode_imu(stamps, vectors, np.zeros(3), "f")
    with pytest.raises(InputError, match="whole nanoseconds"):
        cdr.encode_imu(stamps * 1.0, vectors, vectors, "f")
    with pytest.raises(InputError, match="vertical_mps2 has shape"):
        cdr.encode_accel_stamped(stamps, np.zeros((3, 1)), "f")
    with pytest.raises(InputError, match="NUL"):
        cdr.encode_imu(stamps, vectors, vectors, "a\0b")


# ROS itself as the oracle.


@pytest.fixture(scope="module")
def ros() -> SimpleNamespace:
    """Serialization by rclpy and the two message types, loaded."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the first use of a type imports modules that Python deprecates
        serialization = pytest.importorskip("rclpy.serialization")
        imu, accel = pytest.importorskip("sensor_msgs.msg").Imu, pytest.importorskip("geometry_msgs.msg").AccelStamped
        for kind in (imu, accel):
            serialization.deserialize_message(serialization.serialize_message(kind()), kind)
    return SimpleNamespace(
        write=serialization.serialize_message, read=serialization.deserialize_message, Imu=imu, AccelStamped=accel
    )


@pytest.mark.parametrize("frame_id", ["", "imu_pelvis", "x" * 3, "x" * 4, "x" * 4000])
def test_rclpy_and_this_encoding_read_each_other(ros, frame_id):
    values = np.arange(12, dtype=np.float64).reshape(2, 6) + 0.5
    stamps = np.array([1_700_000_000_999_999_999, -1], dtype=np.int64)
    encoded = cdr.encode_imu(stamps, values[:, :3], values[:, 3:], frame_id)
    read = [ros.read(row.tobytes(), ros.Imu) for row in encoded]
    for message, stamp_ns, row in zip(read, stamps.tolist(), values, strict=True):
        assert message.header.frame_id == frame_id
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp_ns
        accel, gyro, turn = message.linear_acceleration, message.angular_velocity, message.orientation
        assert [accel.x, accel.y, accel.z, gyro.x, gyro.y, gyro.z] == row.tolist()
        assert [turn.x, turn.y, turn.z, turn.w] == [0.0, 0.0, 0.0, 1.0]
        assert message.orientation_covariance.tolist() == [-1.0, *[0.0] * 8]
        assert not message.angular_velocity_covariance.any()
        assert not message.linear_acceleration_covariance.any()

    written = [ros.write(message) for message in read]
    samples = [(stamp, tuple(row), frame_id) for stamp, row in zip(stamps.tolist(), values, strict=True)]
    assert_decodes(cdr.decode_imu(written, gyro=True), samples)
    assert cdr.decode_imu_one(written[0]) == (samples[0][0], samples[0][1][:3])
    moved = ros.read(cdr.restamp(written[0], 42), ros.Imu)
    assert (moved.header.stamp.sec, moved.header.stamp.nanosec, moved.header.frame_id) == (0, 42, frame_id)


def test_rclpy_reads_the_accel_stamped(ros):
    message = ros.read(cdr.AccelStampedTemplate("head").fill(-5, 2.5), ros.AccelStamped)
    assert (message.header.frame_id, message.header.stamp.sec) == ("head", -1)
    linear, angular = message.accel.linear, message.accel.angular
    assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == [0.0, 0.0, 2.5, 0.0, 0.0, 0.0]
