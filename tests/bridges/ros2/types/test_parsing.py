"""What definitions may say, and how a broken rule is reported."""

import pytest

from llfsm.bridges.ros2.errors import DefinitionSyntaxError
from llfsm.bridges.ros2.types.definition import Constant, Field, FieldType, Shape, parse


def fields(text: str) -> tuple[Field, ...]:
    return parse(text, "own/msg/Thing", "Thing.msg")["own/msg/Thing"].fields


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("int32", FieldType("int32")),
        ("Other", FieldType("own/msg/Other")),
        ("far/Other", FieldType("far/msg/Other")),
        ("far/msg/Other[3]", FieldType("far/msg/Other", Shape.ARRAY, 3)),
        ("time", FieldType("builtin_interfaces/msg/Time")),
        ("duration[]", FieldType("builtin_interfaces/msg/Duration", Shape.SEQUENCE)),
        ("string<=5", FieldType("string", bound=5)),
        ("wstring<=5[<=2]", FieldType("wstring", Shape.BOUNDED, 2, 5)),
        ("uint8[16]", FieldType("uint8", Shape.ARRAY, 16)),
    ],
)
def test_types(text, kind):
    assert fields(f"{text} x") == (Field("x", kind),)


@pytest.mark.parametrize(
    ("line", "default"),
    [
        ("int8 x -0x10", -16),
        ("int8 x\t1\t# of them", 1),
        ("bool x True", True),
        ("bool x 0", False),
        ("float32 x -1e-3", -0.001),
        ("string x plain text # told", "plain text"),
        ('string x "it\'s # 1" # told', "it's # 1"),
        (r'string x "say \"yes\""', 'say "yes"'),
        ("string x 'a = b'", "a = b"),
        ("int32[] x [1, -2,3]", (1, -2, 3)),
        ("int32[] x []", ()),
        ("uint8[2] x [1, 255]", b"\x01\xff"),
        ("float64[<=3] x [1]", (1.0,)),
        ("string[] x ['a, b', \"c]\", d]", ("a, b", "c]", "d")),
        ("bool[2] x [true, false]", (True, False)),
    ],
)
def test_defaults(line, default):
    (field,) = fields(line)
    assert field.default == default
    assert type(field.default) is type(default)


def test_constants_comments_and_blank_lines():
    text = """# A thing.
    \t
    uint8 LEAST=0
    int16 A_B2 = -7 # told
    string NAME='x # y'
    string BARE= some text  # told
    float64 PI=3.14
    char LETTER = 65

      int32 x"""
    thing = parse(text, "own/msg/Thing", "Thing.msg")["own/msg/Thing"]
    assert thing.constants == (
        Constant("LEAST", 0, "uint8"),
        Constant("A_B2", -7, "int16"),
        Constant("NAME", "x # y", "string"),
        Constant("BARE", "some text", "string"),
        Constant("PI", 3.14, "float64"),
        Constant("LETTER", 65, "char"),
    )
    assert thing.fields == (Field("x", FieldType("int32")),)


def test_a_file_with_windows_line_ends():
    assert len(fields("int32 x\r\nint32 y\r\n")) == 2


def test_parts_of_a_service_have_their_own_constants():
    made = parse("int8 A=1\n---\nint8 A=2\nint8 x", "own/srv/Ask", "Ask.srv")
    assert made["own/srv/Ask_Request"].constants == (Constant("A", 1, "int8"),)
    assert made["own/srv/Ask_Response"].constants == (Constant("A", 2, "int8"),)
    assert made["own/srv/Ask"].kind == "service"


@pytest.mark.parametrize(
    ("line", "reported"),
    [
        ("int32", "neither a field"),
        ("int32 =5", "neither a field"),
        ("@optional", "neither a field"),
        ("@key int32 x", "not a type"),
        ("in32 x", "'in32' is not a type"),
        ("float128 x", "not a type"),
        ("wchar x", "not a type"),
        ("own/int32 x", "not a type"),
        ("int32[0] x", "an array's size"),
        ("int32[<=] x", "without a number"),
        ("int32[-1] x", "not a type"),
        ("int32<=5 x", "bounds a string"),
        ("string<=0 x", "bounds a string"),
        ("int32 X", "cannot name a field"),
        ("int32 x_", "cannot name a field"),
        ("int32 a__b", "cannot name a field"),
        ("int32 _x", "cannot name a field"),
        ("int32 x=5", "cannot name a constant"),
        ("int32 X_=5", "cannot name a constant"),
        ("int32[] X=5", "primitive type"),
        ("Other X=5", "primitive type"),
        ("Other x 5", "only fields of primitive types"),
        ("uint8 x 256", "256 is not of type uint8, whose range is 0 to 255"),
        ("uint8 X=-1", "-1 is not of type uint8"),
        ("int32 x 1.5", "'1.5' is not of type int32"),
        ("float32 x much", "'much' is not of type float32"),
        ("bool x yes", "'yes' is not of type bool"),
        ("string<=2 x abc", "more than 2 characters"),
        ("int32[2] x [1]", "1 values for an array of 2"),
        ("int32[<=2] x [1,2,3]", "3 values for an array of 2"),
        ("int32[] x 1", "written in brackets"),
        ("int32[] x [1,,2]", "commas"),
        ("int32[] x [1", "written in brackets"),
    ],
)
def test_what_breaks_the_rules_is_reported_with_its_line(line, reported):
    with pytest.raises(DefinitionSyntaxError) as caught:
        parse(f"# A thing.\nint32 first\n{line}\n", "own/msg/Thing", "some/Thing.msg")
    assert str(caught.value).startswith("some/Thing.msg:3: ")
    assert reported in str(caught.value)
    assert line in str(caught.value)


def test_two_fields_of_one_name():
    with pytest.raises(DefinitionSyntaxError, match=r"Thing.msg:2: x is defined twice"):
        fields("int32 x\nint8 x")


@pytest.mark.parametrize(
    ("name", "text", "reported"),
    [
        ("own/msg/Thing", "int32 x\n---\n", "a .msg has 1 parts.*this one has 2"),
        ("own/srv/Ask", "int32 x\n", "a .srv has 2 parts.*this one has 1"),
        ("own/action/Do", "---\n", "a .action has 3 parts"),
        ("own/msg/thing", "", "cannot name a definition"),
        ("own/srv/Ask_Request", "---", "cannot name a definition"),
    ],
)
def test_files_that_are_no_such_definition(name, text, reported):
    with pytest.raises(DefinitionSyntaxError, match=reported):
        parse(text, name, "file")
