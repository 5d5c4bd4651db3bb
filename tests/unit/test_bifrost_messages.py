"""Encoding and decoding are inverse, and other bytes are rejected."""

import json
import math
from typing import Annotated, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bifrost
from bifrost.messages import ArrayKind, Message, Schema
from bifrost.reflection import field_types, schema_of, type_from_schema
from harness.examples import examples

pytestmark = pytest.mark.portable


class Inner(bifrost.Message):
    values: bifrost.Float64Array
    name: str


class Everything(bifrost.Message):
    number: int
    real: float
    flag: bool
    text: str
    blob: bytes
    reals: bifrost.Float64Array
    octets: bifrost.Uint8Array
    inner: Inner
    inners: list[Inner]
    names: list[str]
    maybe: Inner | None
    perhaps: float | None


doubles = st.lists(st.floats(width=64), max_size=40).map(lambda v: np.array(v, np.float64))
inners = st.builds(Inner, doubles, st.text(max_size=10))
everythings = st.builds(
    Everything, st.integers(-(2**63), 2**63 - 1), st.floats(), st.booleans(), st.text(max_size=20),
    st.binary(max_size=20), doubles, st.binary(max_size=40).map(lambda b: np.frombuffer(b, np.uint8)), inners,
    st.lists(inners, max_size=3), st.lists(st.text(max_size=5), max_size=3), st.none() | inners,
    st.none() | st.floats(),
)  # fmt: skip
CODEC = bifrost.codec(Everything)


@given(everythings)
def test_round_trip_keeps_every_bit(message: Everything) -> None:
    decoded = CODEC.decode(CODEC.encode(message))
    assert type(decoded) is Everything and decoded == message
    assert not decoded != message  # noqa: SIM202 - msgspec has an inequality of its own
    assert decoded.reals.tobytes() == message.reals.tobytes()
    assert decoded.reals.dtype == np.float64 and decoded.octets.dtype == np.uint8
    assert decoded.reals.flags.aligned and not decoded.reals.flags.writeable and decoded.inner.values.ndim == 1


@given(everythings)
def test_a_class_made_from_the_schema_is_the_same_to_everybody(message: Everything) -> None:
    made = type_from_schema(CODEC.schema)
    codec = bifrost.codec(made)
    assert codec.hash == CODEC.hash
    decoded = codec.decode(CODEC.encode(message))
    assert codec.encode(decoded) == CODEC.encode(message)
    assert bifrost.to_builtins(decoded) == bifrost.to_builtins(message)


def _finite(value: Any) -> Any:
    """The same with NaN for whatever JSON cannot say."""
    if isinstance(value, Message):
        return type(value)(*(_finite(getattr(value, name)) for name in value.__struct_fields__))
    if isinstance(value, np.ndarray):
        return np.where(np.isfinite(value), value, np.nan) if value.dtype == np.float64 else value
    if isinstance(value, list):
        return [_finite(element) for element in value]
    return math.nan if isinstance(value, float) and not math.isfinite(value) else value


@given(everythings)
def test_json_and_back(message: Everything) -> None:
    text = json.dumps(bifrost.to_builtins(message), allow_nan=False)
    back = bifrost.from_json(Everything, text)
    expected = _finite(message)
    if expected.perhaps is not None and math.isnan(expected.perhaps):
        expected.perhaps = None  # null means both
    assert bifrost.to_builtins(back) == bifrost.to_builtins(expected)


@examples(300)
@given(st.binary(max_size=200))
def test_noise_is_refused_by_one_kind_of_error(noise: bytes) -> None:
    try:
        decoded = CODEC.decode(noise)
    except (ValueError, RecursionError):
        return
    assert isinstance(decoded, Everything)


@given(everythings, st.data())
def test_a_message_cut_or_prolonged_is_refused(message: Everything, data: st.DataObject) -> None:
    encoded = CODEC.encode(message)
    cut = data.draw(st.integers(0, len(encoded) - 1))
    for wrong in (encoded[:cut], encoded + b"\0"):
        with pytest.raises(ValueError):
            CODEC.decode(wrong)


@pytest.mark.parametrize("value", [bytes(1), bytes(9), [1.0, 2.0], "text", 5, None, {}])
def test_an_array_that_is_not_bytes_of_complete_elements_is_rejected(value: object) -> None:
    with pytest.raises(ValueError):
        bifrost.codec(Inner).decode(msgspec.msgpack.encode([value, "name"]))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"reals": np.zeros(3, np.float32)}, r"Everything\.reals: .* float64 array, got float32 of shape \(3,\)"),
        ({"reals": np.zeros((2, 2))}, r"Everything\.reals: .* got float64 of shape \(2, 2\)"),
        ({"reals": np.array(1.0)}, r"Everything\.reals: .* got float64 of shape \(\)"),
        ({"reals": [1.0]}, r"Everything\.reals: .* got list"),
        ({"reals": np.zeros(8, np.uint8)}, r"Everything\.reals: .* got uint8"),
        ({"octets": np.zeros(1)}, r"Everything\.octets: expected a one-dimensional uint8 array, got float64"),
        ({"inner": Inner(np.zeros(1, int), "")}, r"Everything\.inner\.values: .* got int64"),
        ({"inners": [Inner(np.zeros(1), ""), Inner(np.zeros((1, 1)), "")]}, r"Everything\.inners\[1\]\.values"),
        ({"maybe": Inner(b"", "")}, r"Everything\.maybe\.values: .* got bytes"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_what_would_be_misread_is_not_sent(fields: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {
        "number": 1, "real": 1.0, "flag": True, "text": "", "blob": b"", "reals": np.zeros(1),
        "octets": np.zeros(1, np.uint8), "inner": Inner(np.zeros(1), ""), "inners": [], "names": [], "maybe": None,
        "perhaps": None,
    }  # fmt: skip
    assert CODEC.encode(Everything(**good))
    with pytest.raises(TypeError, match=message):
        CODEC.encode(Everything(**(good | fields)))


class Counted(bifrost.Message):
    one: int
    many: list[int]
    maybe: int | None


@pytest.mark.parametrize("value", [2**63, 2**64 - 1])
@pytest.mark.parametrize("field", ["one", "many", "maybe"])
def test_integers_beyond_64_signed_bits_are_neither_sent_nor_taken(value: int, field: str) -> None:
    codec = bifrost.codec(Counted)
    fields: dict[str, Any] = {"one": 1, "many": [1], "maybe": 1}
    fields[field] = [value] if field == "many" else value
    with pytest.raises(TypeError, match=rf"Counted\.{field}.*: expected an integer of 64 bits, got {value}"):
        codec.encode(Counted(**fields))
    with pytest.raises(msgspec.ValidationError):
        codec.decode(msgspec.msgpack.encode(list(fields.values())))
    made = bifrost.codec(type_from_schema(codec.schema))
    with pytest.raises(msgspec.ValidationError):
        made.decode(msgspec.msgpack.encode(list(fields.values())))
    with pytest.raises(bifrost.SchemaError, match=rf"Counted: .*{field}"):
        bifrost.from_json(Counted, json.dumps(fields))


def test_arrays_that_are_not_contiguous_are_sent_in_order() -> None:
    every_second = np.arange(10.0)[::2]
    decoded = bifrost.codec(Inner).decode(bifrost.codec(Inner).encode(Inner(every_second, "")))
    assert decoded.values.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]


class Marked(bifrost.Message):
    """Arrays by the mark alone: what stands before it is as unlike NumPy's aliases as it may become."""

    reals: Annotated[Any, ArrayKind.FLOAT64]
    octets: Annotated[Any, ArrayKind.UINT8]
    many: list[Annotated[Any, ArrayKind.UINT8]]
    maybe: Annotated[Any, ArrayKind.FLOAT64] | None


def test_an_array_is_known_by_its_mark_alone() -> None:
    codec = bifrost.codec(Marked)
    assert [text for _, text in codec.schema.types["Marked"]] == ["float64[]", "uint8[]", "list<uint8[]>", "float64[]?"]
    message = Marked(np.arange(3.0), np.arange(8, dtype=np.uint8), [np.zeros(16, np.uint8)], np.ones(1))
    text = json.dumps(bifrost.to_builtins(message))
    for again in (codec.decode(codec.encode(message)), bifrost.from_json(Marked, text)):
        assert again == message and again.maybe is not None and again.reals.dtype == again.maybe.dtype == np.float64
        assert again.octets.dtype == again.many[0].dtype == np.uint8
    for field, wrong in {"reals": np.zeros(8, np.uint8), "octets": np.zeros(1), "maybe": np.zeros(8, np.uint8)}.items():
        with pytest.raises(TypeError, match=rf"Marked\.{field}: expected a one-dimensional"):
            codec.encode(msgspec.structs.replace(message, **{field: wrong}))


def test_the_fields_of_a_type_are_those_declared_whatever_its_codec_made_of_them() -> None:
    assert bifrost.codec(Marked).schema == schema_of(Marked)
    assert field_types(Counted)["one"] is int

    class More(Everything):
        inner: Counted  # type: ignore[assignment]

    declared = dict(CODEC.schema.types["Everything"]) | {"inner": "Counted"}
    assert dict(schema_of(More).types["More"]) == declared


def _type(name: str, *fields: tuple[str, Any]) -> type[Message]:
    return msgspec.defstruct(name, fields, bases=(Message,), array_like=True, gc=False, eq=False)  # type: ignore[return-value]


def test_the_hash_is_what_the_documentation_states() -> None:
    """Fixed for ever: another implementation computes it from the text."""
    schema = schema_of(_type("Temperature", ("celsius", float), ("history", bifrost.Float64Array)))
    assert schema == Schema("Temperature", {"Temperature": [["celsius", "float"], ["history", "float64[]"]]})
    assert schema.digest().hex() == "3d922996398d4d0a"


def test_the_bytes_are_what_the_documentation_states() -> None:
    """Fixed for ever, likewise: every type of field in turn."""
    message = Everything(
        -2, 0.5, True, "é", b"\1", np.array([1.0]), np.array([7, 8], np.uint8), Inner(np.zeros(0), "i"), [], ["n"],
        None, 2.0,
    )  # fmt: skip
    assert CODEC.hash.hex() == "19bc48ec93e2d12c"
    assert CODEC.encode(message).hex(" ") == (
        "9c fe cb 3f e0 00 00 00 00 00 00 c3 a2 c3 a9 c4 01 01 "
        "c4 08 00 00 00 00 00 00 f0 3f c4 02 07 08 "  # arrays: little-endian, msgpack: big
        "92 c4 00 a1 69 90 91 a1 6e c0 cb 40 00 00 00 00 00 00 00"
    )


@pytest.mark.parametrize("field", [dict, set, "np", tuple[int, ...], int | str, complex])
def test_a_type_that_no_message_can_have_is_named(field: Any) -> None:
    wrong = _type("Wrong", ("field", np.ndarray if field == "np" else field))
    with pytest.raises(TypeError, match=r"Wrong\.field: .* is not supported in a message"):
        bifrost.codec(wrong)


@pytest.mark.parametrize(
    "schema",
    [
        Schema("A", {}),
        Schema("A", {"A": [["x", "B"]]}),
        Schema("A", {"A": [["x", "A"]]}),
        Schema("A", {"A": [["x", "list<"]]}),
        Schema("A", {"A": [["x"]]}),
        Schema("A", {"A": [["not a name", "int"], ["not a name", "int"]]}),
        Schema("A", {"A": [["x", "B"]], "B": [["y", "list<A>"]]}),
    ],
)
def test_a_schema_that_is_not_well_formed_is_refused(schema: Schema) -> None:
    with pytest.raises(bifrost.SchemaError, match="schema of A"):
        type_from_schema(schema)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"values": [1.0]}', "Inner: Object missing required field `name`; expected an object of values, name"),
        ('{"values": [1.0], "name": "", "x": 1}', "Inner: .* unknown field `x`"),
        ('{"values": 1.0, "name": ""}', r"got `float` - at `\$\.values`"),
        ('{"values": [[1.0]], "name": ""}', r"got `array` - at `\$\.values\[0\]`"),
        ('{"values": [], "name": 3}', r"got `int` - at `\$\.name`"),
        ("[1]", "Expected `object`, got `array`"),
        ("{", "truncated"),
    ],
)
def test_json_that_is_not_the_message_is_named(text: str, message: str) -> None:
    with pytest.raises(bifrost.SchemaError, match=message):
        bifrost.from_json(Inner, text)


def test_json_with_elements_that_do_not_fit_is_rejected() -> None:
    with pytest.raises(bifrost.SchemaError, match="Marked"):
        bifrost.from_json(Marked, '{"reals": [], "octets": [300], "many": [], "maybe": null}')
