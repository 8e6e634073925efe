"""What people mistype: each error names what is wrong, where it is, and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from calling import call

MACHINE = """
from llfsm.runtime import Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool, Float64


class Lamp(Machine):
    door = Sensor(Slot("door", Float64))
    count: int = 0
    OFF = State()
    ON = State()
    OFF.to(ON, when=lambda self: self.door is not None)
"""

SAFETY = """
from llfsm.runtime.verification import never

stays_off = never(lambda v: v.Lamp.state == "ON", "it stays off")
"""

BAD_PLAN = """
[[machine]]
definition = "lamp:Lamp"
period = 3
"""

RELAY = """[[relay]]
slot = "a"
type = "geometry_msgs/msg/Twist"
direction = "to-ros"
"""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    for name, text in {
        "lamp.py": MACHINE,
        "safety.py": SAFETY,
        "broken.py": "class Lamp(:\n",
        "robot.toml": '[[machine]]\ndefinition = "lamp:Lamp"\n',
        "bad.toml": BAD_PLAN,
        "relay.toml": RELAY,
        "run.mcap": "",
    }.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("typed", "printed"),
    [
        # commands and options
        ("rnu lamp", "no command 'rnu'; did you mean 'run'?"),
        ("help", "no command 'help'; see `llfsm --help`"),
        ("whiteboard ls", "no command 'ls'; "),
        ("whiteboard show", "no command 'show'; see `llfsm whiteboard --help`"),
        ("run lamp --perid 20", "No such option '--perid'. Did you mean '--period'?"),
        ("run lamp --period abc", "'--period': 'abc' is not a valid integer."),
        ("demo wall --seconds x", "'--seconds': 'x' is not a valid number."),
        ("demo wal", "'wal' is not one of 'wall', 'blind', 'suspend', 'pingpong'"),
        ("edit lamp:Lamp --host 0.0.0.0", "'--host'. Did you mean '--address'?"),
        ("edit lamp:Lamp --prt 80", "'--prt'. Did you mean '--port'?"),
        ("view --port 99999", "99999 is not in the range"),
        # machines
        ("run", "name a machine to run; `llfsm run --help` shows examples"),
        ("run Lamp", "no machine 'Lamp'; those that ship: "),
        ("run Lamp", "did you mean 'lamp:Lamp'?"),
        ("run lmap:Lamp", "there is no module 'lmap'; did you mean 'lamp'?"),
        ("run lmap.py", "there is no file lmap.py; did you mean 'lamp.py'?"),
        ("run lamp:Lmap", "its machines: Lamp; did you mean 'Lamp'?"),
        ("run broken.py", "broken.py:1: SyntaxError: invalid syntax"),
        ("run lamp Lamp:cont=3", "Lamp has no variable 'cont'; it has: count; did you mean"),
        ("run lamp Lamp:count=x", "'Lamp:count=x': "),
        ("run lamp:Lamp:count=3", "'lamp:Lamp:count=3' sets a variable or a slot of one"),
        ("edit Lamps", "no bundle 'Lamps'; make one with: llfsm new Lamps"),
        ("new my-lamp", "'my-lamp' cannot name a machine: use letters, digits and _"),
        ("draw lamp -o lamp.jpg", "lamp.jpg: its suffix is not that of a format (.dot"),
        # files
        ("run robt.toml", "robt.toml: cannot be read: No such file"),
        ("run robt.toml", "did you mean 'robot.toml'"),
        ("run robot.tml", "did you mean 'robot.toml'"),
        ("run bad.toml", "bad.toml:4: machine[0]: there is no key 'period' here; did you mean"),
        ("replay run.mcp", "run.mcp: cannot be read: No such file or directory; did you mean"),
        ("replay lamp.py", "lamp.py: is not a recording of llfsm, nor a bag of ROS 2"),
        (
            "view lamp:Lamp",
            "lamp:Lamp is not a recording, which comes first; `llfsm edit lamp:Lamp`",
        ),
        ("draw lamp --format jpg", "'jpg' is not one of 'dot', 'mermaid', 'svg', 'png'"),
        ("package robot.toml", "robot.toml is an arrangement file, not a machine"),
        (
            "bridge check relay.toml",
            "relay.toml:4: relay[0].direction: Invalid enum value 'to",
        ),
        ("bridge check relay.toml", "not one of 'both', 'from_ros', 'to_ros'; did you mean"),
        ("bridge check brige.toml", "brige.toml: cannot be read: No such file"),
        # proofs
        ("verify lamp -p safety:stays_of", "safety has no 'stays_of'; did you mean 'stays_off'?"),
        ("verify lamp --sensor door", "'door': give it as SLOT=DOMAIN"),
        ("verify lamp --sensor dor=every", "they read: door; did you mean 'door'?"),
        ("verify lamp", "or on the command line --sensor SLOT=DOMAIN"),
        (
            "verify lamp --sensor door=every",
            "the type float has too many values to list",
        ),
        # whiteboards
        ("ps -b nothing-here", "no such whiteboard; start the program that makes it, or see"),
        ("run lamp -b a/b", "'a/b' is not a valid whiteboard name: use 1 to 200 letters"),
        ("guard -b robot/7", "'robot/7' is not a valid whiteboard name"),
        ("view -b robot/7 --no-open", "'robot/7' is not a valid whiteboard name"),
        ("whiteboard add x {} --type Bool", "'Bool': give it as package.module:Class, or as"),
        ("whiteboard add x {} --type std_msg/Bool", "did you mean 'std_msgs'?"),
        ("whiteboard add x {} --type std_msgs/Bol", "did you mean 'Bool'?"),
        # hosts and ROS
        ("whiteboard daemon --listen 0.0.0.0:7447", "did you mean tcp/0.0.0.0:7447?"),
        ("whiteboard daemon --connect tcp/robot.local", "did you mean tcp/robot.local:7447?"),
        ("whiteboard daemon -c robot.toml", "robot.toml:1: there is no key 'machine' here"),
        ("whiteboard daemon --as robot/7", "'robot/7' cannot be the name of a host"),
        ("router --listen 7448", "no router: '7448' is not an endpoint; did you mean tcp/"),
        ("bridge ros2", "nothing to connect: give --config, --to-ros, --from-ros or --both"),
        ("bridge ros2 --to-ros cmd_vel", "write NAME:TYPE, as pose:turtlesim/msg/Pose"),
        ("turtlesim --turtle bob,1,2", "'bob,1,2' is not NAME,X,Y,THETA"),
    ],
)
def test_a_mistake_is_named_with_what_to_do(
    here: Path, board: str, monkeypatch: pytest.MonkeyPatch, typed: str, printed: str
) -> None:
    monkeypatch.setenv("WHITEBOARD_NAME", board)
    done = call(*typed.split(), cwd=here)
    assert done.returncode in (1, 2), done.stdout
    assert printed in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("message", "printed"),
    [
        ("{data: true}", 'not a JSON object such as {"data": ...}: Expecting property name'),
        ("true", 'not a JSON object such as {"data": ...}'),
        (
            '{"dta": true}',
            "std_msgs/msg/Bool has no field 'dta'; it has data; did you mean",
        ),
        ('{"data": 1}', "Expected `bool`, got `int` - at `data`"),
    ],
)
def test_a_message_that_is_none_is_shown_one(
    here: Path, board: str, message: str, printed: str
) -> None:
    done = call(
        "whiteboard", "add", "x", message, "--type", "std_msgs/Bool", "-b", board, cwd=here
    )  # fmt: skip
    assert done.returncode == 1
    assert printed in done.stderr
