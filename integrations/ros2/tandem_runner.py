#!/usr/bin/env python3
"""Goes through a proven file of trajectories, step by step, on a controller of ROS 2.

python3 tandem_runner.py out --controller /joint_trajectory_controller

``out`` is a result folder: its ``proof.json`` has to say that the proof holds, and to name this very file by
its SHA-256. Outputs are services ``/tandem/NAME`` (std_srvs/SetBool) that answer once the output has the
value, inputs topics ``/tandem/NAME`` (std_msgs/Bool). While it runs it publishes ``/tandem/alive``
(std_msgs/Empty) ten times a second; what switches power takes it back by itself where that ends.

Whatever fails, and on Ctrl-C, the goal is cancelled, all outputs that are on go off, and nothing more is
done. It never goes on in the middle: begin again from the start. No ROS has run it yet; it is tested with
stand-ins for the names that it uses."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

VERSION = 2
"""The form of the file that is run."""
FRESH_S = 0.5
"""Joints that were heard of longer ago count for nothing, also while they move."""
LOOK_S = 0.1
"""How often it looks, while something lasts, whether they are heard of."""
ANSWER_S = 5.0
"""How long a service or an action may take to answer."""
ALIVE_HZ = 10.0
"""How often it says that it runs."""
SUCCEEDED = 4
"""action_msgs/GoalStatus: the goal was reached."""
ENDED = (SUCCEEDED, 5, 6)
"""The same, or it was cancelled or aborted: nothing moves for it."""

Row = dict[str, Any]


class StoppedError(Exception):
    """A step did not end as it has to: nothing more is done."""


class Cell(Protocol):
    """What a file needs of a cell. Each call raises ``StoppedError`` where it does not end as it has to."""

    def check(self, joints: Sequence[str], outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Everything that the file names is there."""

    def posture(self, joints: Sequence[str]) -> list[float]:
        """Where joints stand now [rad]."""

    def follow(self, joints: Sequence[str], move: Row, points: Sequence[Row]) -> None:
        """A goal, to its end."""

    def cancel(self) -> None:
        """Cancel what moves, without waiting."""

    def rests(self) -> bool:
        """Whether what was cancelled has said that it ended; waits for it."""

    def switch(self, name: str, on: bool) -> None:
        """Switch an output, and be sure of it."""

    def wait_for(self, name: str, value: bool, seconds: float) -> None:
        """Wait for an input."""

    def ask(self, text: str) -> None:
        """Ask the operator, who says yes."""

    def tell(self, text: str) -> None:
        """Tell the operator."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


def proven(folder: Path) -> list[Row]:
    """The rows of the one file of a result folder. Raises ``StoppedError`` for one that is not proven, or
    that is not the file that was."""
    try:
        proof = json.loads((folder / "proof.json").read_text("utf-8"))
        named = dict(proof["programs"])
        holds = proof["ok"] is True
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoppedError(f"{folder}: no proof is there ({type(error).__name__}: {error})") from error
    if not holds:
        raise StoppedError(f"{folder}: the proof does not hold")
    files = [name for name in named if name.endswith(".trajectory.jsonl")]
    if len(files) != 1 or len(named) != 1:
        raise StoppedError(f"{folder}: the proof names {', '.join(named) or 'nothing'}; one file is run")
    content = (folder / "programs" / files[0]).read_bytes()
    if hashlib.sha256(content).hexdigest() != named[files[0]]:
        raise StoppedError(f"{files[0]} is not the file that was proven; prove it again: tandem verify")
    rows = rows_of(content)
    if rows[0].get("problem_digest") != proof.get("problem_digest"):
        raise StoppedError(f"{files[0]} was written for another problem than the proof is of")
    _not_withdrawn(folder, proof.get("problem_digest"), named)
    return rows


def _not_withdrawn(folder: Path, digest: Any, named: dict[str, Any]) -> None:
    """Raise ``StoppedError`` where a service says, in a ``release.json`` that came with the result, that its
    release was withdrawn, or where that is of other programs."""
    for path in (folder / "release.json", folder / "programs" / "release.json"):
        if not path.is_file():
            continue
        try:
            data = json.loads(path.read_text("utf-8"))
            same = data["digest"] == digest and dict(data["programs"]) == named
            good = data["release"] is None or data["released"] is True
            says = "".join(one for one in str(data["says"]) if one.isprintable())
        except (ValueError, KeyError, TypeError) as error:
            raise StoppedError(f"{path}: no release ({type(error).__name__}: {error})") from error
        if not same:
            raise StoppedError(f"{path} is of other programs: {says}")
        if not good:
            raise StoppedError(f"{path}: {says}")


def rows_of(content: bytes) -> list[Row]:
    """The rows of a file, whose last one counts and seals them. Raises ``StoppedError``."""
    lines = content.decode("ascii").replace("\r\n", "\n").split("\n")
    if lines.pop() != "":
        raise StoppedError("the file was cut off")
    rows: list[Row] = [json.loads(line) for line in lines]
    head, end = rows[0], rows[-1]
    if head.get("tandem_trajectory") != VERSION:
        raise StoppedError(f"form {head.get('tandem_trajectory')} of the file; {VERSION} is run here")
    sealed = hashlib.sha256("".join(f"{line}\n" for line in lines[:-1]).encode("ascii")).hexdigest()
    if end.get("end") != len(rows) or end.get("sha256") != sealed:
        raise StoppedError("the rows are not those that the file was closed with")
    return rows[:-1]


def steps(rows: Sequence[Row]) -> Iterator[tuple[Row, list[Row]]]:
    """Each step, a move with its points."""
    move: Row | None = None
    points: list[Row] = []
    for row in rows[1:]:
        if "t" in row:
            points.append(row)
        elif "segment" not in row:
            if move is not None:
                yield move, points
            move, points = (row, []) if "move" in row else (None, [])
            if move is None:
                yield row, []
    if move is not None:
        yield move, points


def run(rows: Sequence[Row], cell: Cell) -> None:
    """Go through a file. Raises ``StoppedError`` where it came to no end; then all outputs that were on are
    off and the goal has ended, or the message says what is not so."""
    joints = [name for row in rows if "arm" in row and "joints" in row for name in row["joints"]]
    outputs = list(dict.fromkeys(row["set"] for row in rows if "set" in row))
    inputs = list(dict.fromkeys(row["await"] for row in rows if "await" in row))
    on: list[str] = []
    row: Row = {}
    try:
        cell.check(joints, outputs, inputs)
        for row, points in steps(rows):
            _step(row, points, joints, cell, on)
    except BaseException as error:
        left, rests = _fallen(cell, list(dict.fromkeys([*on, *row.get("on_failure", [])])))
        what = str(error) or type(error).__name__
        what += f"; NOT SWITCHED OFF: {', '.join(left)}: take the power at once" if left else ""
        what += "" if rests else "; THE ARMS MAY STILL MOVE: nothing says that the goal was cancelled"
        raise StoppedError(what) from error
    if on:
        _fallen(cell, on)
        raise StoppedError(f"{', '.join(on)} was on at the end")


def _step(row: Row, points: Sequence[Row], joints: Sequence[str], cell: Cell, on: list[str]) -> None:
    key = next(iter(row))
    if key == "tell":
        cell.tell(row["tell"])
    elif key == "ask":
        cell.ask(row["ask"])
    elif key == "set":
        if row["to"]:
            on.append(row["set"])  # before: what fails half way is taken back, too
        cell.switch(row["set"], bool(row["to"]))
        if not row["to"] and row["set"] in on:
            on.remove(row["set"])
    elif key == "await":
        cell.wait_for(row["await"], bool(row["to"]), row["within"])
    elif key == "dwell":
        cell.sleep(row["dwell"])
    elif key == "at":
        _look(row, joints, cell)
    elif key == "move":
        cell.follow(joints, row, points)
    elif key == "operation":
        held = f", the block is held by arm {row['held_by']}" if row["held_by"] else ""
        cell.tell(f"Operation {row['operation']}, setup {row['setup']}{held}.")
    elif key == "carry":
        cell.ask(_load(row))
    elif key == "tool":
        cell.tell(f"Arm {row['arm']} has {row['tool']}, {row['mass']:g} kg.")
    elif key != "arm":
        raise StoppedError(f"a row {key!r} is not known here")


def _load(row: Row) -> str:
    """What is asked where an arm takes the block, or lets it go."""
    if not row["mass"]:
        return f"Arm {row['carry']} holds no block any more: does its controller count with none?"
    centre = ", ".join(f"{1000.0 * value:.1f}" for value in row["centre"])
    return (
        f"Arm {row['carry']} holds a block of {row['mass']:g} kg, its centre at {centre} mm in the frame of "
        "the TCP: does its controller know?"
    )


def _look(row: Row, joints: Sequence[str], cell: Cell) -> None:
    here = cell.posture(joints)
    for name, got, wanted in zip(joints, here, row["at"]):
        if not abs(got - wanted) <= row["within"]:  # NaN is no posture either
            raise StoppedError(
                f"{name} stands at {got:.5f} rad; {wanted:.5f} within {row['within']:g} is wanted: arms home "
                "by hand, begin again"
            )


def _fallen(cell: Cell, names: Sequence[str]) -> tuple[list[str], bool]:
    """Cancel what moves and switch off; the outputs of which that is not sure, and whether the arms rest."""
    left, rests = [], False
    with contextlib.suppress(BaseException):  # outputs have to fall all the same
        cell.cancel()
    for name in names:
        try:
            cell.switch(name, False)
        except BaseException:  # the next one has to fall all the same
            left.append(name)
    with contextlib.suppress(BaseException):  # behind the outputs: power does not wait for it
        rests = cell.rests()
    return left, rests


# ---- ROS 2 ----


class RosCell:
    """A cell by the names of ROS 2: one action of a joint_trajectory_controller, services, topics."""

    def __init__(self, node: Any, controller: str, prefix: str = "/tandem") -> None:
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty

        self.node, self.prefix = node, prefix
        self.action = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
        self.states: dict[str, tuple[float, float]] = {}
        self.inputs: dict[str, bool] = {}
        self.services: dict[str, Any] = {}
        self.handle: Any = None
        self.sent: Any = None
        self.ends: Any = None
        self.cancelled: Any = None
        self.stopped = False
        self.joints: Sequence[str] = ()
        node.create_subscription(JointState, "/joint_states", self._heard, 10)
        alive = node.create_publisher(Empty, f"{prefix}/alive", 1)
        node.create_timer(1.0 / ALIVE_HZ, lambda: alive.publish(Empty()))

    def _heard(self, message: Any) -> None:
        now = time.monotonic()
        self.states.update({name: (now, at) for name, at in zip(message.name, message.position)})

    def check(self, joints: Sequence[str], outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Action, services and topics are there, joints of all names are heard of, and no other runner is at
        work."""
        from std_msgs.msg import Bool
        from std_srvs.srv import SetBool

        if not self.action.wait_for_server(timeout_sec=ANSWER_S):
            raise StoppedError("the controller's action is not there")
        for name in outputs:
            service = self.node.create_client(SetBool, f"{self.prefix}/{name}")
            if not service.wait_for_service(timeout_sec=ANSWER_S):
                raise StoppedError(f"the service {self.prefix}/{name} is not there")
            self.services[name] = service
        for name in inputs:
            self.node.create_subscription(
                Bool, f"{self.prefix}/{name}", lambda told, own=name: self.inputs.update({own: told.data}), 1
            )
        end = time.monotonic() + ANSWER_S
        while not all(name in self.states for name in joints):
            if time.monotonic() > end:
                lost = ", ".join(name for name in joints if name not in self.states)
                raise StoppedError(f"nothing is heard of the joints {lost}")
            time.sleep(0.05)
        if self.node.count_publishers(f"{self.prefix}/alive") > 1:
            raise StoppedError(f"another runner is at work: somebody else says {self.prefix}/alive")
        self.joints = joints

    def posture(self, joints: Sequence[str]) -> list[float]:
        """Joints by name, heard of just now."""
        self._hears(joints)
        return [self.states[name][1] for name in joints]

    def _hears(self, joints: Sequence[str]) -> None:
        """Joints of all these names were heard of just now."""
        now = time.monotonic()
        old = [name for name in joints if now - self.states[name][0] > FRESH_S]
        if old:
            raise StoppedError(f"nothing new is heard of the joints {', '.join(old)}")

    def follow(self, joints: Sequence[str], move: Row, points: Sequence[Row]) -> None:
        """Send a goal, and wait for its end: a driver or controller that dies on the way says nothing, but
        nothing more is heard of its joints."""
        self.sent = self.action.send_goal_async(goal_of(joints, move, points))
        self.sent.add_done_callback(self._answered)
        handle = self._done(self.sent, ANSWER_S)
        if not handle.accepted:
            self.sent = None
            raise StoppedError("the controller refuses the goal")
        self.handle, self.ends = handle, handle.get_result_async()
        ended = self._done(self.ends, points[-1]["t"] + move["goal_time"] + ANSWER_S, self.joints)
        if ended.status != SUCCEEDED or ended.result.error_code != 0:
            code, said = ended.result.error_code, ended.result.error_string
            raise StoppedError(f"the move did not end: status {ended.status}, error {code} {said}")
        self.sent = self.handle = self.ends = None

    def _answered(self, sent: Any) -> None:
        """Keep a goal that is accepted; one that is accepted behind a stop is cancelled."""
        with contextlib.suppress(Exception):  # else the thread ends that outputs are switched off by
            handle = sent.result()
            if handle.accepted and self.sent is sent:
                self.handle = handle
                if self.stopped:
                    self.cancelled = handle.cancel_goal_async()

    def cancel(self) -> None:
        """Cancel the goal, if there is one, and any that is accepted yet."""
        self.stopped = True
        if self.handle is not None:
            self.cancelled = self.handle.cancel_goal_async()

    def rests(self) -> bool:
        """Whether no goal is under way, by the controller's own answers."""
        if self.sent is None:
            return True
        handle = self._done(self.sent, ANSWER_S)
        if not handle.accepted:
            return True
        self._done(self.cancelled or handle.cancel_goal_async(), ANSWER_S)
        return self._done(self.ends or handle.get_result_async(), ANSWER_S).status in ENDED

    def switch(self, name: str, on: bool) -> None:
        """Call the service of an output."""
        from std_srvs.srv import SetBool

        answer = self._done(self.services[name].call_async(SetBool.Request(data=on)), ANSWER_S)
        if not answer.success:
            raise StoppedError(f"{name} was not switched: {answer.message}")

    def wait_for(self, name: str, value: bool, seconds: float) -> None:
        """Wait for an input's topic."""
        end = time.monotonic() + seconds
        while self.inputs.get(name) is not value:
            if time.monotonic() > end:
                raise StoppedError(f"{name} was not {int(value)} within {seconds:g} s")
            time.sleep(0.01)

    def ask(self, text: str) -> None:
        """Ask at the terminal: what was typed before counts for nothing."""
        with contextlib.suppress(Exception):  # no terminal, or another system
            import termios

            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        if input(f"{text} (yes) ").strip().lower() != "yes":
            raise StoppedError(f"no yes to: {text}")

    def tell(self, text: str) -> None:
        """Tell at the terminal."""
        print(text)

    def sleep(self, seconds: float) -> None:
        """Wait."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._hears(self.joints)
            time.sleep(min(left, LOOK_S))

    def _done(self, future: Any, seconds: float, joints: Sequence[str] = ()) -> Any:
        """What a future gives, which another thread works on, while ``joints`` are heard of."""
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        end = time.monotonic() + seconds
        while not done.wait(min(LOOK_S, max(end - time.monotonic(), 0.0))):
            self._hears(joints)
            if time.monotonic() >= end:
                raise StoppedError(f"no answer within {seconds:g} s")
        return future.result()


def goal_of(joints: Sequence[str], move: Row, points: Sequence[Row]) -> Any:
    """The goal of a move."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTolerance
    from trajectory_msgs.msg import JointTrajectoryPoint

    def duration(seconds: float) -> Any:
        whole, rest = divmod(round(seconds * 1e9), 1_000_000_000)
        return Duration(sec=whole, nanosec=rest)

    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(joints)
    goal.trajectory.points = [
        JointTrajectoryPoint(
            positions=list(map(float, row["q"])),  # whole numbers of JSON are none of ROS
            velocities=list(map(float, row["v"])),
            time_from_start=duration(row["t"]),
        )
        for row in points
    ]
    goal.path_tolerance = [JointTolerance(name=n, position=float(v)) for n, v in zip(joints, move["path"])]
    goal.goal_tolerance = [JointTolerance(name=n, position=float(v)) for n, v in zip(joints, move["goal"])]
    goal.goal_time_tolerance = duration(move["goal_time"])
    return goal


STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""A terminal that is closed, or lost, is a stop too."""


def stop(number: int, frame: Any) -> None:
    """What a signal does: it stops the run, once; a second one would keep outputs from being switched off."""
    for one in STOPS:
        signal.signal(one, signal.SIG_IGN)
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: 0 where the file came to its end."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("folder", type=Path, help="result folder of tandem plan")
    parser.add_argument("--controller", default="/joint_trajectory_controller")
    given = parser.parse_args(arguments)
    try:
        rows = proven(given.folder)
    except (StoppedError, OSError, ValueError) as error:
        print(f"nothing was done: {error}", file=sys.stderr)
        return 2
    import rclpy
    from rclpy.executors import MultiThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    # its own handlers would end the services on Ctrl-C, before outputs are switched off
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in STOPS:
        signal.signal(number, stop)
    node = rclpy.create_node("tandem_runner")
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    try:
        run(rows, RosCell(node, given.controller))
    except StoppedError as error:
        print(f"STOPPED: {error}", file=sys.stderr)
        return 1
    finally:
        for number in STOPS:
            signal.signal(number, signal.SIG_DFL)
        executor.shutdown()
        rclpy.shutdown()
    print("Done.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
