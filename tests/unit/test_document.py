"""YAML files: values on which YAML 1.1 and 1.2 agree are read; others are errors with file, line and key."""

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

pytestmark = pytest.mark.portable

FILE = Path("some.yaml")
BOUND = 20.0  # of the processor's time, for the worst file of the largest size on a slow computer [s]


def load(text: str | bytes) -> Any:
    return Document(FILE, text.encode() if isinstance(text, str) else text).content


def refusal(text: str | bytes) -> str:
    with pytest.raises(ConfigurationError) as refused:
        load(text)
    reported = str(refused.value)
    assert reported.startswith(str(FILE)) and "\n" not in reported
    return reported.removeprefix(f"{FILE}:")


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


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12), ("+3", 3), ("0x1F", 31), ("-.5", -0.5), ("6.02E+23", 6.02e23), ("true", True), ("~", None),
        ("", None), ("y", "y"), ("1.1.26", "1.1.26"), ("'yes'", "yes"), ('"0300"', "0300"), ("|\n  no\n", "no\n"),
    ],
)  # fmt: skip
def test_plain_words_mean_what_both_yamls_say(text: str, value: object) -> None:
    got = load(f"key: {text}")["key"]
    assert (got, type(got)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("yes", "got yes; expected true or false"),
        ("No", "got No; expected true or false"),
        ("0300", "got 0300; expected a decimal number without leading zeros"),
        ("0o17", "without leading zeros"),
        ("5:00", "got 5:00; expected a decimal number in the key's unit"),
        ("1_000", "without underscores"),
        ("2015-06-05", "a date in quotes"),
        ("9" * 19, "a number of at most 18 digits"),
        ("9" * 5000, "a number of at most 18 digits"),
        ("!!python/object/apply:os.system [id]", "the tag"),
        ("*nobody", "found undefined alias"),
        ("&here [*here]", "nested mappings and lists, with aliases expanded"),
        ("[&a 1, &a 2]", "found duplicate anchor"),
        ("{b: 1, b: 2}", "key.b: duplicate key; also in line 2"),
        ("{1: a}", "got the key 1; expected text"),
        ("{on: a}", "got on; expected"),
        ("{[a]: 1}", "got a mapping or a list as a key"),
        ("{<<: 3}", "expected a mapping, or a list of mappings"),
        ("{<<: {a: 1}, <<: {b: 1}}", "key.<<: duplicate key"),
        ("{", "not YAML"),
        ("'\0'", "not YAML"),
    ],
)
def test_ambiguous_and_invalid_values_are_rejected(text: str, words: str) -> None:
    reported = refusal(f"first: 1\nkey: {text}\n")
    assert words in reported
    assert reported.startswith(("2:", "3:")) or "\0" in text


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n", "5:3: b.c: duplicate key; also in line 3"),
        (
            "a: 1\n---\nb: 2\n",
            "2:1: (whole file): not YAML: expected a single document in the stream, but found another document",
        ),
        (b"a: 1\nb: \xe9\n", "2: expected text in UTF-8, got byte 0xe9"),
        ("a: [{b: yes}]\n", "1:9: a.0.b: got yes; expected true or false, or quotes around text"),
    ],
)
def test_errors_give_line_and_column(text: str, reported: str) -> None:
    assert refusal(text).strip() == reported


def test_every_key_has_its_location_through_aliases_and_merges() -> None:
    text = "base: &base\n  a: 1\n  b: [x, &y y]\nmine:\n  <<: *base\n  a: 2\nother: {<<: [*base, {c: 3}], d: *y}\n"
    document = Document(FILE, text.encode())
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
        assert document.location(path.split(".")) == place, path


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
MERGED = "a0: &a0 {k: [1, 2, 3]}\n" + "".join(
    f"a{i}: &a{i} {{<<: *a{i - 1}, p{i}: [{', '.join([f'*a{i - 1}'] * 5)}]}}\n" for i in range(1, 12)
)
CHAIN = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 5000))
HOSTILE = {
    "aliases": BOMB, "merges": MERGED, "a chain of aliases": CHAIN, "flow": "[" * MAX_BYTES,
    "block": "- " * (MAX_BYTES // 2), "too deep": "a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH,
    "too many": "[" + "x," * (MAX_VALUES + 1) + "]", "too large": " " * (MAX_BYTES + 1), "tags": "!" * MAX_BYTES,
    "open": '"' + "a\n" * (MAX_BYTES // 3),
}  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_files_are_rejected_in_bounded_time(text: str) -> None:
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
def test_any_bytes_give_a_document_or_a_configuration_error(data: bytes) -> None:
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
