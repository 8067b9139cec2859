"""The trajectory runner executes proven files with stand-ins for a cell and for the ROS 2 names that it uses.

No ROS runs here.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import sys
import types
from pathlib import Path

import pytest

from tests.languages.trajectories import driven_job

PATH = Path(__file__).parents[2] / "integrations" / "ros2" / "tandem_runner.py"
SPEC = importlib.util.spec_from_file_location("tandem_runner", PATH)
runner = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(runner)


def text():
    (content,) = driven_job.bent_programs().values()
    return content


def rows():
    return runner.rows_of(text().encode())


class FakeCell:
    """A cell that does as it is commanded.

    ``fails`` contains the exceptions: {name of a call: the number of the call, and what it raises}.
    """

    def __init__(self, fails=None, broken=()):
        self.fails, self.broken = fails or {}, broken
        self.calls, self.said = [], []
        self.here, self.on = None, set()

    def _call(self, name, *what):
        self.calls.append((name, *what))
        at, error = self.fails.get(name, (None, None))
        if at == sum(call[0] == name for call in self.calls):
            raise error

    def check(self, joints, outputs, inputs):
        self._call("check", tuple(joints), tuple(outputs), tuple(inputs))

    def posture(self, joints):
        self._call("posture")
        if self.here is None:
            self.here = next(row["at"] for row in rows() if "at" in row)
        return [value + 0.001 for value in self.here]

    def follow(self, joints, move, points):
        self.calls.append(("follow", tuple(move["move"]), len(points), frozenset(self.on)))
        at, error = self.fails.get("follow", (None, None))
        if at == sum(call[0] == "follow" for call in self.calls):
            raise error
        self.here = points[-1]["q"]

    def cancel(self):
        self._call("cancel")

    def rests(self):
        self._call("rests")
        return True

    def switch(self, name, on):
        if not on and name in self.broken:
            raise runner.StoppedError("no answer")
        self._call("switch", name, on)
        self.on = self.on | {name} if on else self.on - {name}

    def wait_for(self, name, value, seconds):
        self._call("wait_for", name, value)

    def ask(self, question):
        self._call("ask", question)

    def tell(self, message):
        self.said.append(message)

    def sleep(self, seconds):
        self._call("sleep", seconds)


def test_a_file_is_gone_through_to_its_end():
    cell = FakeCell()
    runner.run(rows(), cell)
    names = [call[0] for call in cell.calls]
    assert names[0] == "check" and "cancel" not in names
    assert not cell.on
    goals = [call for call in cell.calls if call[0] == "follow"]
    assert len(goals) == names.count("posture") == text().count('"move"')
    assert [goal[3] for goal in goals if goal[1] == ("left", "right")] == [{"doWirePower"}]
    assert all(not goal[3] for goal in goals if len(goal[1]) == 1)
    assert sum(goal[2] for goal in goals) == text().count('"t":')
    asked = [call[1] for call in cell.calls if call[0] == "ask"]
    assert asked == [row["ask"] for row in rows() if "ask" in row]
    assert cell.calls[0][1] == tuple(f"{arm}_joint_{i}" for arm in ("left", "right") for i in range(1, 7))


HOT = next(i for i, (row, _) in enumerate(runner.steps(rows())) if row.get("move") == ["left", "right"])
GOAL = sum("move" in row for row, _ in list(runner.steps(rows()))[: HOT + 1])


@pytest.mark.parametrize(
    ("fails", "expected_text"),
    [
        ({"follow": (GOAL, runner.StoppedError("the move failed: status 6"))}, "status 6"),
        ({"follow": (GOAL, KeyboardInterrupt())}, "KeyboardInterrupt"),
        ({"ask": (3, runner.StoppedError("not answered"))}, "not answered"),
        ({"sleep": (1, KeyboardInterrupt())}, "KeyboardInterrupt"),
        ({"posture": (GOAL, runner.StoppedError("no new states received"))}, "received"),
        ({"switch": (2, runner.StoppedError("not switched"))}, "not switched"),
    ],
)
def test_whatever_fails_power_goes_off_and_nothing_more_moves(fails, expected_text):
    cell = FakeCell(fails)
    with pytest.raises(runner.StoppedError, match=expected_text):
        runner.run(rows(), cell)
    names = [call[0] for call in cell.calls]
    stop = names.index("cancel")
    assert "follow" not in names[stop:] and "ask" not in names[stop:]
    assert ("switch", "doWirePower", False) in cell.calls[stop:-1]
    assert cell.calls[-1] == ("rests",)  # power does not wait for it
    assert not cell.on


@pytest.mark.parametrize("how", [False, runner.StoppedError("no answer"), KeyboardInterrupt()])
def test_a_goal_that_nobody_says_has_ended_is_told(how, monkeypatch):
    cell = FakeCell({"follow": (2, KeyboardInterrupt())})

    def rests():
        if how is not False:
            raise how
        return False

    monkeypatch.setattr(cell, "rests", rests)
    with pytest.raises(runner.StoppedError, match="KeyboardInterrupt; THE ARMS MAY STILL MOVE"):
        runner.run(rows(), cell)


def test_an_output_that_does_not_fall_is_told():
    cell = FakeCell({"follow": (GOAL, runner.StoppedError("aborted"))}, broken=("doWirePower",))
    subset = [row for row in rows() if row.get("set") is None or row["to"]]  # the first row switches it off
    with pytest.raises(runner.StoppedError, match="NOT SWITCHED OFF: doWirePower"):
        runner.run(subset, cell)


def test_arms_that_stand_elsewhere_do_not_move():
    cell = FakeCell()
    cell.here = [0.5] * 12
    with pytest.raises(runner.StoppedError, match="left_joint_1 is at"):
        runner.run(rows(), cell)
    assert not [call for call in cell.calls if call[0] == "follow"]
    cell = FakeCell()
    cell.here = [float("nan")] * 12
    with pytest.raises(runner.StoppedError, match="is at nan"):
        runner.run(rows(), cell)


def result(folder, content=None, ok=True, digest=None, name=driven_job.BENT):
    content = text() if content is None else content
    (folder / "programs").mkdir()
    (folder / "programs" / name).write_bytes(content.encode())
    digest = hashlib.sha256(content.encode()).hexdigest() if digest is None else digest
    proof = {"ok": ok, "problem_digest": "ab12" * 16, "programs": {name: digest}}
    (folder / "proof.json").write_text(json.dumps(proof))
    return folder


def test_only_the_file_that_was_proven_is_run(tmp_path):
    def of(number, **values):
        folder = tmp_path / str(number)
        folder.mkdir()
        return result(folder, **values)

    assert runner.proven(of(0)) == rows()
    for number, (values, said) in enumerate(
        (
            ({"ok": False}, "does not hold"),
            ({"digest": "0" * 64}, "not the file that was proven"),
            ({"name": "wing.script"}, "required is one trajectory file"),
            ({"content": text().replace('"within":0.006981', '"within":0.906981', 1)}, "do not match"),
            ({"content": text()[:-40]}, "file is incomplete"),
            ({"content": text().replace("ab12ab12", "cd34cd34", 1)}, "do not match"),
        ),
        start=1,
    ):
        with pytest.raises(runner.StoppedError, match=said):
            runner.proven(of(number, **values))
    assert runner.main([str(tmp_path / "nowhere")]) == 2


@pytest.mark.parametrize("file_name", ["release.json", "programs/release.json"])
def test_programs_whose_release_was_withdrawn_are_not_run(tmp_path, file_name):
    folder = result(tmp_path)
    proof = json.loads((folder / "proof.json").read_text())
    given = {"digest": proof["problem_digest"], "programs": proof["programs"], "says": "withdrawn\x1b by A"}

    def write_and_read(**values):
        (folder / file_name).write_text(json.dumps({**given, **values}))
        return runner.proven(folder)

    assert write_and_read(released=True, release=1) == write_and_read(released=False, release=None) == rows()
    for values, said in (
        ({"released": False, "release": 1}, "withdrawn by A"),
        ({"released": True, "release": 1, "programs": {}}, "other programs"),
        ({"released": True, "release": 1, "digest": "0" * 64}, "other programs"),
        ({"released": True}, "not a valid release"),
    ):
        with pytest.raises(runner.StoppedError, match=said):
            write_and_read(**values)


class Future:
    """One that is done, unless its value is ``None``."""

    def __init__(self, value):
        self.value = value

    def result(self):
        return self.value

    def add_done_callback(self, call):
        if self.value is not None:
            call(self)


class Message:
    def __init__(self, **values):
        self.__dict__.update(values)


class Goal:
    def __init__(self):
        self.trajectory = Message()


@pytest.fixture
def ros(monkeypatch):
    """Stand-ins for the ROS 2 names that the runner uses."""
    said = types.SimpleNamespace(
        goals=[],
        cancelled=0,
        status=4,
        code=0,
        accepted=True,
        switched=[],
        success=True,
        answer=Message(),
        runners=1,
        ends=True,
    )

    class Action:
        def __init__(self, node, kind, name):
            said.action = name

        def wait_for_server(self, timeout_sec):
            return True

        def send_goal_async(self, goal):
            said.goals.append(goal)
            ended = Message(status=said.status, result=Message(error_code=said.code, error_string="why"))
            ended = ended if said.ends else None

            def cancel():
                said.cancelled += 1
                return Future(said.answer)

            return Future(
                Message(
                    accepted=said.accepted, get_result_async=lambda: Future(ended), cancel_goal_async=cancel
                )
            )

    class Node:
        def create_subscription(self, kind, name, call, depth):
            said.__dict__.setdefault("heard", {})[name] = call

        def create_publisher(self, kind, name, depth):
            return Message(publish=lambda one: None)

        def create_timer(self, period, call):
            call()

        def count_publishers(self, topic):
            assert topic == "/tandem/alive"
            return said.runners

        def create_client(self, kind, name):
            def call_async(request):
                said.switched.append((name, request.data))
                return Future(Message(success=said.success, message=""))

            return Message(wait_for_service=lambda timeout_sec: True, call_async=call_async)

    names = {
        "control_msgs.action": {"FollowJointTrajectory": type("F", (), {"Goal": Goal})},
        "control_msgs.msg": {"JointTolerance": Message},
        "rclpy.action": {"ActionClient": Action},
        "sensor_msgs.msg": {"JointState": Message},
        "std_msgs.msg": {"Empty": Message, "Bool": Message},
        "std_srvs.srv": {"SetBool": type("S", (), {"Request": Message})},
        "builtin_interfaces.msg": {"Duration": Message},
        "trajectory_msgs.msg": {"JointTrajectoryPoint": Message},
    }
    for name, values in names.items():
        package = name.partition(".")[0]
        monkeypatch.setitem(sys.modules, package, types.ModuleType(package))
        module = types.ModuleType(name)
        module.__dict__.update(values)
        monkeypatch.setitem(sys.modules, name, module)
    said.cell = runner.RosCell(Node(), "/arms")
    return said


def test_goals_have_points_velocities_and_tolerances_by_name(ros):
    assert ros.action == "/arms/follow_joint_trajectory"
    joints = [name for row in rows() if "joints" in row for name in row["joints"]]
    ros.heard["/joint_states"](Message(name=joints[::-1], position=list(range(12))[::-1]))
    ros.cell.check(joints, ["doWirePower"], [])
    assert ros.cell.posture(joints) == list(range(12))
    move, points = next(step for step in runner.steps(rows()) if step[0].get("move") == ["left", "right"])
    ros.cell.follow(joints, move, points)
    (goal,) = ros.goals
    assert goal.trajectory.joint_names == joints
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in goal.trajectory.points]
    assert times == pytest.approx([row["t"] for row in points], abs=1e-9)
    assert [p.velocities for p in goal.trajectory.points] == [row["v"] for row in points]
    assert {t.name: t.position for t in goal.path_tolerance} == dict(zip(joints, move["path"], strict=True))
    assert len(goal.goal_tolerance) == 12 and goal.goal_time_tolerance.sec == 2
    ros.cell.switch("doWirePower", True)
    assert ros.switched == [("/tandem/doWirePower", True)]


@pytest.mark.parametrize(
    ("values", "expected_text"), [({"status": 6}, "status 6"), ({"code": -4}, "error -4 why")]
)
def test_a_goal_that_is_aborted_stops(ros, values, expected_text):
    ros.__dict__.update(values)
    joints = ["a"]
    move, points = {"path": [0.1], "goal": [0.1], "goal_time": 1.0}, [{"t": 1.0, "q": [0.0], "v": [0.0]}]
    with pytest.raises(runner.StoppedError, match=expected_text):
        ros.cell.follow(joints, move, points)
    ros.cell.cancel()
    assert ros.cancelled == 1 and ros.cell.rests()
    ros.status, ros.code = 4, 0
    ros.cell.follow(joints, move, points)  # accepted behind the stop: cancelled
    assert ros.cancelled == 2 and ros.cell.rests()


def test_an_interrupted_goal_rests_where_the_controller_says_so(ros, monkeypatch):
    move, points = {"path": [0.1], "goal": [0.1], "goal_time": 1.0}, [{"t": 1.0, "q": [0.0], "v": [0.0]}]
    done = ros.cell._done

    def interrupted(future, seconds, joints=()):
        raise KeyboardInterrupt

    def stopped(**values):
        ros.__dict__.update({"status": 5, "answer": Message(), **values})
        ros.cell.cancelled = ros.cell.ends = None
        ros.cell.stopped = False
        monkeypatch.setattr(ros.cell, "_done", interrupted)
        with pytest.raises(KeyboardInterrupt):  # before anybody looked at what the controller answered
            ros.cell.follow(["a"], move, points)
        monkeypatch.setattr(ros.cell, "_done", done)
        before = ros.cancelled
        ros.cell.cancel()
        assert ros.cancelled == before + 1
        return ros.cell.rests()

    assert stopped()
    assert not stopped(status=2)
    monkeypatch.setattr(runner, "ANSWER_S", 0.01)
    with pytest.raises(runner.StoppedError, match="no answer"):
        stopped(answer=None)


def test_a_terminal_that_is_closed_is_a_stop(ros, monkeypatch, tmp_path):
    caught = {}
    monkeypatch.setattr(runner.signal, "signal", caught.__setitem__)
    rclpy = sys.modules["rclpy"]
    node = types.SimpleNamespace()
    for name in ("init", "shutdown"):
        monkeypatch.setattr(rclpy, name, lambda **more: None, raising=False)
    monkeypatch.setattr(rclpy, "create_node", lambda name: node, raising=False)
    executor = Message(add_node=lambda one: None, spin=lambda: None, shutdown=lambda: None)
    for name, values in (
        ("rclpy.executors", {"MultiThreadedExecutor": lambda: executor}),
        ("rclpy.signals", {"SignalHandlerOptions": Message(NO=0)}),
    ):
        module = types.ModuleType(name)
        module.__dict__.update(values)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(runner, "RosCell", lambda *given: FakeCell())
    assert runner.main([str(result(tmp_path))]) == 0
    expected = [getattr(runner.signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    assert caught == dict.fromkeys(expected, runner.signal.SIG_DFL)  # the run is over
    with pytest.raises(KeyboardInterrupt):
        runner.stop(runner.signal.SIGINT, None)
    assert caught == dict.fromkeys(expected, runner.signal.SIG_IGN)  # a second one keeps nothing on


def test_a_goal_that_is_refused_and_an_output_that_answers_no_stop(ros):
    ros.accepted, ros.success = False, False
    move, points = {"path": [0.1], "goal": [0.1], "goal_time": 1.0}, [{"t": 1.0, "q": [0.0], "v": [0.0]}]
    with pytest.raises(runner.StoppedError, match="rejected"):
        ros.cell.follow(["a"], move, points)
    ros.heard["/joint_states"](Message(name=["a"], position=[0.0]))
    ros.cell.check(["a"], ["x"], [])
    with pytest.raises(runner.StoppedError, match="x was not switched"):
        ros.cell.switch("x", True)
    with pytest.raises(KeyError):
        ros.cell.posture(["b"])
    ros.cell.states["a"] = (-10.0, 0.0)
    with pytest.raises(runner.StoppedError, match="no new states"):
        ros.cell.posture(["a"])


def test_a_driver_that_dies_on_the_way_stops_at_once(ros, monkeypatch):
    """No answer and no abort arrive: the wire would burn until the move is late."""
    move, points = {"path": [0.1], "goal": [0.1], "goal_time": 1.0}, [{"t": 900.0, "q": [0], "v": [0.0]}]
    ros.heard["/joint_states"](Message(name=["a"], position=[0.0]))
    ros.cell.check(["a"], [], [])
    monkeypatch.setattr(runner, "FRESH_S", 0.02)
    monkeypatch.setattr(runner, "LOOK_S", 0.01)
    ros.ends = None
    before = runner.time.monotonic()
    with pytest.raises(runner.StoppedError, match="no new states received of the joints a"):
        ros.cell.follow(["a"], move, points)
    with pytest.raises(runner.StoppedError, match="no new states received"):
        ros.cell.sleep(900.0)
    assert runner.time.monotonic() - before < 60.0
    assert isinstance(ros.goals[0].trajectory.points[0].positions[0], float)  # ROS takes no whole number


def test_a_second_runner_does_nothing(ros):
    ros.heard["/joint_states"](Message(name=["a"], position=[0.0]))
    ros.runners = 2
    with pytest.raises(runner.StoppedError, match="another runner"):
        ros.cell.check(["a"], [], [])
