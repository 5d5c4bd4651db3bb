"""YAML of people's: what is read is what both YAMLs mean by it; all else is one line with file, line and key."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import REPOSITORY
from valor.common.document import MAX_BYTES, MAX_DEPTH, MAX_VALUES, Document
from valor.common.errors import ConfigurationError

FILE = Path("some.yaml")
OURS = sorted(
    file
    for folder in ("deploy", "examples", "robots", "services")
    for file in (REPOSITORY / folder).rglob("*.yaml")
)  # fmt: skip
BOUND = 20.0  # of the processor's time, for the worst file of the largest size on a slow computer [s]


def load(text: str | bytes) -> Any:
    """The content of a text."""
    return Document.of(FILE, text.encode() if isinstance(text, str) else text).content


def refusal(text: str | bytes) -> str:
    """What is said of a text."""
    with pytest.raises(ConfigurationError) as refused:
        load(text)
    told = str(refused.value)
    assert told.startswith(str(FILE))
    assert "\n" not in told
    return told.removeprefix(f"{FILE}:")


def same(one: Any, other: Any) -> bool:
    """Equal in type, value and order; PyYAML takes 1e5 and -.5 for text."""
    if isinstance(one, float) and isinstance(other, str):
        return one == float(other)
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other or one != one)  # not a number


@pytest.mark.parametrize("file", OURS, ids=lambda file: str(file.relative_to(REPOSITORY)))
def test_our_files_are_read_as_by_pyyaml(file: Path) -> None:
    assert same(Document.load(file).content, yaml.safe_load(file.read_text()))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12),
        ("-3", -3),
        ("+3", 3),
        ("0", 0),
        ("0x1F", 31),
        ("1.", 1.0),
        ("-.5", -0.5),
        ("1e-3", 0.001),
        ("6.02E+23", 6.02e23),
        ("true", True),
        ("False", False),
        ("~", None),
        ("", None),
        ("NULL", None),
        ("y", "y"),
        ("n", "n"),
        ("1.1.26", "1.1.26"),
        ("socketcan:can0", "socketcan:can0"),
        ("'yes'", "yes"),
        ('"0300"', "0300"),
        ("|\n  no\n", "no\n"),
        ("trueish", "trueish"),
    ],
)
def test_plain_words_mean_what_both_yamls_say(text: str, value: object) -> None:
    got = load(f"key: {text}")["key"]
    assert (got, type(got)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("yes", "got yes; expected true or false"),
        ("No", "got No; expected true or false"),
        ("on", "expected true or false"),
        ("OFF", "expected true or false"),
        ("0300", "got 0300; expected a decimal number without leading zeros"),
        ("-007", "without leading zeros"),
        ("0o17", "without leading zeros"),
        ("0b101", "without leading zeros"),
        ("5:00", "got 5:00; expected a decimal number in the key's unit"),
        ("1:30:00.5", "a decimal number in the key's unit"),
        ("1_000", "without underscores"),
        ("1_0.5", "without underscores"),
        ("2015-06-05", "a date in quotes"),
        ("9" * 19, "a number of at most 18 digits"),
        ("9" * 5000, "a number of at most 18 digits"),
        ("0x" + "f" * 16, "a number of at most 18 digits"),
        ("!!float 3", "the tag tag:yaml.org,2002:float"),
        ("!!python/object/apply:os.system [id]", "the tag"),
        ("!mine 3", "the tag !mine"),
        ("! 3", "the tag !"),
        ("*nobody", "got *nobody; expected one of the anchors"),
        ("&here [*here]", "got *here; expected one of the anchors"),
        ("[&a 1, &a 2]", "a second anchor &a"),
        ("&a {b: &a 1}", "a second anchor &a"),
        ("{b: 1, b: 2}", "key.b: stands twice, in line 2"),
        ('{b: 1, "b": 2}', "key.b: stands twice"),
        ("{1: a}", "got the key 1; expected text"),
        ("{~: a}", "got the key None; expected text"),
        ("{true: a}", "got the key True; expected text"),
        ("{on: a}", "got on; expected"),
        ("{[a]: 1}", "got a mapping or a list as a key"),
        ("{<<: 3}", "expected a mapping, or a list of them"),
        ("{<<: [1]}", "expected a mapping, or a list of them"),
        ("{<<: {a: 1}, <<: {b: 1}}", "key.<<: stands twice"),
        ("{", "not YAML"),
        ("a: b", "not YAML"),
        ("'\0'", "not YAML"),
    ],
)
def test_what_means_two_things_or_nothing_is_refused(text: str, words: str) -> None:
    told = refusal(f"first: 1\nkey: {text}\n")
    assert words in told
    assert told.startswith(("2:", "3:")) or "\0" in text


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", "5:3: b.c: stands twice, in line 3, too"),
        ("a: 1\n---\nb: 2\n", "2:1: (whole file): got a second document (---); expected one"),
        (b"a: 1\nb: \xe9\n", "2: expected text in UTF-8, got byte 0xe9"),
        ("a: [1, yes]\n", "1:8: a.1: got yes; expected true or false, or quotes around text"),
        ("a: [{b: yes}]\n", "1:9: a.0.b: got yes; expected true or false, or quotes around text"),
    ],
)
def test_places_are_named_to_the_column(text: str, told: str) -> None:
    assert refusal(text).strip() == told


def test_every_key_has_its_place_through_aliases_and_merges() -> None:
    text = "base: &base\n  a: 1\n  b: [x, &y y]\nmine:\n  <<: *base\n  a: 2\nother: {<<: [*base, {c: 3}], d: *y}\n"
    document = Document.of(FILE, text.encode())
    assert document.content == yaml.safe_load(text)
    for path, place in (
        ("base", (1, 1)),
        ("mine", (4, 1)),
        ("mine.a", (6, 3)),
        ("mine.b", (3, 3)),
        ("mine.b.1", (3, 10)),
        ("other.a", (2, 3)),
        ("other.c", (7, 22)),
        ("other.d", (7, 30)),
        ("other.e", (7, 1)),
        ("nothing.at.all", (1, 1)),
    ):
        assert document.place(path.split(".")) == place, path


def test_mappings_that_are_merged_come_first_and_own_keys_win() -> None:
    text = "a: &a {x: 1, y: 2}\nb: &b {y: 3, z: 4}\nc: {w: 0, <<: [*a, *b], z: 5}\n"
    assert same(load(text), yaml.safe_load(text))


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
MERGED = "a0: &a0 {k: [1, 2, 3]}\n" + "".join(
    f"a{i}: &a{i} {{<<: *a{i - 1}, p{i}: [{', '.join([f'*a{i - 1}'] * 5)}]}}\n" for i in range(1, 12)
)
CHAIN = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 5000))
HOSTILE = {
    "aliases": BOMB,
    "merges": MERGED,
    "a chain of aliases": CHAIN,
    "flow": "[" * MAX_BYTES,
    "flow mappings": "{a: " * (MAX_BYTES // 4),
    "block": "- " * (MAX_BYTES // 2),
    "keys": "? " * (MAX_BYTES // 2),
    "too deep": "a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH,
    "too many": "[" + "x," * (MAX_VALUES + 1) + "]",
    "too large": " " * (MAX_BYTES + 1),
    "tags": "!" * MAX_BYTES,
    "open": '"' + "a\n" * (MAX_BYTES // 3),
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_bombs_do_not_go_off(text: str) -> None:
    began = time.process_time()
    assert refusal(text)
    assert time.process_time() - began < BOUND


def test_the_largest_harmless_files_are_read() -> None:
    keys = "".join(f"k{i}: 1\n" for i in range(MAX_BYTES // 12))
    assert len(load(keys)) == MAX_BYTES // 12
    deep = "[" * MAX_DEPTH + "]" * MAX_DEPTH
    assert load(deep) is not None


def test_only_files_are_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="expected a file"):
        Document.load(tmp_path)
    with pytest.raises(ConfigurationError, match="expected a file"):
        Document.load(Path("/dev/zero"))


def outcome(data: bytes) -> Any:
    """The content, or None where it is refused."""
    try:
        return load(data)
    except ConfigurationError as error:
        assert "\n" not in str(error)
        return None


@given(st.binary(max_size=200) | st.text("{}[]&*!|>-?:,#'\"%@`~<= \n\tab01", max_size=80).map(str.encode))
@examples(300)
def test_any_bytes_are_a_document_or_a_configuration_error(data: bytes) -> None:
    outcome(data)


ROBOT = (REPOSITORY / "robots" / "escher" / "robot.yaml").read_bytes()
PIECES = [" ", "\n", "  ", ": ", "- ", "#", "0", "_", "[", "}", "&a ", "*hdt", "<<: ", "'", "!", "\xe9", "\0"]


@given(st.data())
@examples(150)
def test_a_file_that_was_damaged_is_read_as_by_pyyaml_or_refused(data: st.DataObject) -> None:
    text = ROBOT
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(text)))
        end = place + data.draw(st.sampled_from([0, 0, 1, 2, 10, 200]))
        instead = data.draw(st.sampled_from([b"", text[place:end] * 2, *(piece.encode("latin-1") for piece in PIECES)]))
        text = text[:place] + instead + text[end:]
    content = outcome(text)
    assert content is None or same(content, yaml.load(text, Loader=yaml.CSafeLoader))
