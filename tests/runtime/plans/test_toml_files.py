"""What is wrong in a TOML file is reported with its file and line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.engine.errors import ConfigurationError, FsmError
from llfsm.runtime.plans import line_of, read_toml


class Wheel(msgspec.Struct, forbid_unknown_fields=True):
    radius: int = 1
    label: str = ""
    parts: tuple[int, ...] = ()
    limits: dict[str, int] = {}


class Robot(msgspec.Struct, forbid_unknown_fields=True):
    wheel: tuple[Wheel, ...] = ()
    body: Wheel = msgspec.field(default_factory=Wheel)
    name: str = ""
    speed: int = 0
    notes: tuple[Any, ...] = ()


def read(folder: Path, text: str) -> Robot:
    file = folder / "robot.toml"
    file.write_text(text, encoding="utf-8", newline="")
    return read_toml(file, Robot)


def error_in(folder: Path, text: str) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        read(folder, text)
    error = caught.value
    assert error.file == folder / "robot.toml"
    assert str(error).startswith(f"{error.file}:{error.line}: ")
    return error


def test_a_good_file_is_read(tmp_path: Path) -> None:
    text = 'name = "r"\r\nbody.radius = 2\r\n[[wheel]]\r\nparts = [\r\n 1,\r\n]\r\n[[wheel]]\r\n'
    assert read(tmp_path, text) == Robot((Wheel(parts=(1,)), Wheel()), Wheel(2), "r")
    assert read(tmp_path, "") == Robot()


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("name = \n", 1, "Invalid value"),
        ("# a\n\nname 3\n", 3, "Expected '=' after a key"),
        ('name = "a"\nname = "b"\n', 2, "Cannot overwrite a value"),
        ("[body]\n[body]\n", 2, "Cannot declare ('body',) twice"),
        ('name = "a"\nspeed = 1.2.3', 2, "Expected newline or end of document"),
        ('speed = 1\nname = "a', 2, "Unterminated string"),
        ('speed = 1\nname = """a\nb\n', 3, "Unterminated string"),
        ("notes = [1,\n2,\n", 2, "Invalid value"),
        ("body = {radius = 1", 1, "Unclosed inline table"),
        ("[[wheel]\n", 1, "Expected ']]'"),
        ("notes = [2024-02-30]", 1, "Invalid date or datetime"),
    ],
)
def test_a_syntax_error(tmp_path: Path, text: str, line: int, what: str) -> None:
    error = error_in(tmp_path, text)
    assert (error.line, what in error.what) == (line, True), str(error)


@pytest.mark.parametrize("text", ["speed = " + "1" * 5000, "notes = " + "[" * 5000])
def test_what_the_parser_itself_chokes_on_is_no_crash(tmp_path: Path, text: str) -> None:
    with pytest.raises(FsmError, match=r"robot\.toml"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("color = 1", 1, "there is no key 'color' here"),
        ("speed = 1\n\n# color\n  color = 1", 4, "there is no key 'color' here"),
        ("\n'' = 1", 2, "there is no key '' here"),
        ('"the color" = 1', 1, "there is no key 'the color' here"),
        ("speed = 1\n'color' = 1", 2, "there is no key 'color' here"),
        ("speed = 1\ncolor.of.body = 1", 2, "there is no key 'color' here"),
        ("[body]\nradius = 1\ncolor = 2", 3, "body: there is no key 'color' here"),
        ("speed = 1\n\n[body.color]\nred = 2", 3, "body: there is no key 'color' here"),
        ("[[wheel]]\n[[wheel]]\ncolor = 1\n[[wheel]]\n", 3, "wheel[1]: there is no key"),
        ("[[wheel]]\ncolor = 1\n[[wheel]]\ncolor = 2", 2, "wheel[0]: there is no key"),
        ("speed = 1\nbody = {radius = 1, color = 2}", 2, "body: there is no key"),
        ("wheel = [\n{radius = 1},\n{color = 1}]", 1, "wheel[1]: there is no key"),
        ("[colors]\n[colors.red]\n[body]\nradius = 1", 1, "there is no key 'colors' here"),
    ],
)
def test_an_unknown_key(tmp_path: Path, text: str, line: int, what: str) -> None:
    error = error_in(tmp_path, text)
    assert (error.line, what in error.what) == (line, True), str(error)


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("name = 'a'\nspeed = 'fast'", 2, "speed: Expected `int`, got `str`"),
        ("speed = true", 1, "speed: Expected `int`, got `bool`"),
        ("\n[body]\n radius = 1.5 # [m]\n", 3, "body.radius: Expected `int`, got `float`"),
        ("speed = 1\nbody.radius = 'a'", 2, "body.radius: Expected"),
        ("speed = 1\nbody . 'radius' = 'a'", 2, "body.radius: Expected"),
        ("speed = 1\n[ 'body' ] # it\n\"radius\" = 'a'", 3, "body.radius: Expected"),
        ("[[wheel]]\nradius = 1\n[[wheel]]\nradius = 'a'", 4, "wheel[1].radius: Expected"),
        ("[[wheel]]\n[[ wheel ]]\nlimits.a = 'a'", 3, "wheel[1].limits: Expected"),
        ("[[wheel]]\n[[wheel]]\n[wheel.limits]\na = 'a'", 3, "wheel[1].limits: Expected"),
        ("body = {radius = 'a', label = 'b'}", 1, "body.radius: Expected"),
        ("[[wheel]]\nparts = [1, 2, 'a']", 2, "wheel[0].parts[2]: Expected `int`, got `str`"),
        ("speed = 1\n[wheel]\nradius = 1", 2, "wheel: Expected `array`, got `object`"),
        ("speed = 1\n\nwheel = 3", 3, "wheel: Expected `array`, got `int`"),
        ("wheel = [3]", 1, "wheel[0]: Expected `object`, got `int`"),
    ],
)
def test_a_wrong_type(tmp_path: Path, text: str, line: int, what: str) -> None:
    error = error_in(tmp_path, text)
    assert (error.line, what in error.what) == (line, True), str(error)


LOOKALIKES = [
    'name = """\nspeed = 1\n[[wheel]]\n"""',
    "name = '''\nspeed = 1\n[body]\nradius = 1'''",
    'name = """\n[!]\n[]\n[[ ]]\n= 1\n"""',
    'name = """\n[body\n[[wheel]\n. = """',
    "notes = [\n[1, 2],\n[3, 4]\n]",
    "notes = [\n[ ],\n  [ ]\n]",
    "notes = [\n['a'],\n[\"]\"]\n]",
    "notes = [\n# speed = 1\n# [body]\n]",
    "notes = [\n{ speed = 1 },\n'''\nspeed = 2'''\n]",
    "# speed = 1\n#[body]\n# [[wheel]]",
    "name = '[body]' # [body]",
    "# a\u2028b\u0085c",
    "name = '\u2028'",
]


@pytest.mark.parametrize("before", LOOKALIKES)
@pytest.mark.parametrize(
    "wrong", ["speed = 'x'", "[body]\nradius = 'x'", "[[wheel]]\nradius = 'x'"]
)
def test_values_that_look_like_keys_and_headers_are_no_such(
    tmp_path: Path, before: str, wrong: str
) -> None:
    text = f"{before}\n{wrong}\n"
    assert error_in(tmp_path, text).line == text.count("\n")


@pytest.mark.parametrize(
    "key", ['"a]b"', "'a = b'", '"a.b"', '"[a]"', '"a\\"b"', '"\\u0061"', "''"]
)
def test_the_line_of_a_key_that_needs_quotes(key: str) -> None:
    (name,) = tomllib.loads(f"{key} = 1")
    assert line_of(f"x = 1\n{key} = 2", (name,)) == 2
    assert line_of(f"x = 1\n\n[{key}]\ny = 2", (name, "y")) == 4
    assert line_of(f"[[t]]\n[[t]]\n{key} = 2", ("t", 1, name)) == 3


def test_what_has_no_line_of_its_own_has_that_of_what_it_is_in() -> None:
    text = "[body]\nparts = [\n1,\n2]\n"
    assert line_of(text, ("body", "parts", 1)) == 2
    assert line_of(text, ("body", "radius")) == 1
    assert line_of(text, ("wheel", 0)) is None


# A document is made of statements, each of one or more lines; one of them holds a wrong value.

FILLERS = st.sampled_from(
    [
        "",
        "# radius = 1",
        "  # [body]",
        'label = """\nradius = 1\n[[wheel]]\n"""',
        "parts = [ # ]\n1,\n]",
    ]
)
WRONG = st.sampled_from(
    [
        "radius = 'x'",
        "'radius' = 1.5",
        '  "radius"=[]',
        "color = 1",
        "limits = {a = 'x'}",
        "limits.a=''",
    ]
)


@st.composite
def documents(draw: st.DrawFn) -> tuple[str, int]:
    """Draw a document with one wrong statement, and the line on which that begins."""
    headers = draw(st.lists(st.just("[[wheel]]"), min_size=1, max_size=4))
    headers.insert(draw(st.integers(0, len(headers))), "[body]")
    guilty = draw(st.integers(0, len(headers) - 1))
    lines: list[str] = []
    wrong_line = 0
    for number, header in enumerate(headers):
        lines.append(draw(st.sampled_from([header, f"  {header} # here"])))
        fillers = draw(st.lists(FILLERS, unique=True, max_size=4))
        if number == guilty:
            fillers.insert(draw(st.integers(0, len(fillers))), "WRONG")
        for filler in fillers:
            if filler == "WRONG":
                wrong_line = len(lines) + 1
                filler = draw(WRONG)
            lines += filler.split("\n")
    return "\n".join(lines), wrong_line


@given(documents())
def test_a_wrong_value_anywhere_is_found(
    tmp_path_factory: pytest.TempPathFactory, document: tuple[str, int]
) -> None:
    text, line = document
    tomllib.loads(text)
    assert error_in(tmp_path_factory.getbasetemp(), text).line == line, text


@given(st.text(alphabet="ab=[]{}\"'#.,\\ \n\u2028\x0b1-", max_size=40))
def test_no_text_is_a_crash_or_names_a_line_outside(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    line: int | None = 1
    try:
        read(tmp_path_factory.getbasetemp(), text)
    except ConfigurationError as error:
        line = error.line
    assert line in range(1, text.count("\n") + 2)


@given(st.text(alphabet="ab=[]{}\"'#., \n!\u2028", max_size=40))
def test_no_string_is_a_crash_or_misleads(
    tmp_path_factory: pytest.TempPathFactory, inside: str
) -> None:
    text = "name = '''\n" + inside.replace("'''", "") + " '''\nspeed = 'x'\n"
    assert error_in(tmp_path_factory.getbasetemp(), text).line == text.count("\n")


def test_a_check_reports_where(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text("[[wheel]]\n[[wheel]]\nradius = 3\n")

    def check(robot: Robot) -> None:
        raise ConfigurationError("is too big", ("wheel", 1, "radius"))

    with pytest.raises(ConfigurationError) as caught:
        read_toml(file, Robot, check)
    assert str(caught.value) == f"{file}:3: wheel[1].radius: is too big"


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    for file, why in ((tmp_path / "none.toml", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ConfigurationError, match=f"{file}: cannot be read: {why}"):
            read_toml(file, Robot)


def test_a_file_that_is_no_utf_8(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_bytes(b"speed = 1\nname = '\xe9'\n")
    with pytest.raises(ConfigurationError) as caught:
        read_toml(file, Robot)
    assert caught.value.file == file
    assert "UTF-8" in str(caught.value)
