#!/usr/bin/env python3
"""Run a proven trajectory file, step by step, on a controller of ROS 2.

python3 tandem_runner.py out --controller /joint_trajectory_controller

``out`` is a result folder. Its ``proof.json`` must state that the proof holds, and contain the SHA-256 of
the file. Outputs are services ``/tandem/NAME`` (std_srvs/SetBool) that answer once the output has the
value. Inputs are topics ``/tandem/NAME`` (std_msgs/Bool). While it runs it publishes ``/tandem/alive``
(std_msgs/Empty) ten times per second. Whatever switches power must switch it off by itself when these
messages stop.

On any failure, and on Ctrl-C, the goal is cancelled, all outputs that are on are switched off, and nothing
more is done. The runner never continues in the middle: restart from the beginning. It has not been run on
ROS yet. It is tested with stand-ins for the names that it uses.
"""

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
"""Supported version of the trajectory file."""
FRESH_S = 0.5
"""Maximum age [s] of joint states, also during motion."""
LOOK_S = 0.1
"""Interval [s] of checks of joint states while something lasts."""
ANSWER_S = 5.0
"""Maximum time [s] of an answer of a service or an action."""
ALIVE_HZ = 10.0
"""Rate [1/s] of alive messages."""
SUCCEEDED = 4
"""action_msgs/GoalStatus: the goal was reached."""
ENDED = (SUCCEEDED, 5, 6)
"""action_msgs/GoalStatus: the goal was reached, cancelled or aborted, so it causes no more motion."""

Row = dict[str, Any]


class StoppedError(Exception):
    """A step did not end as required. Nothing more is done."""


class Cell(Protocol):
    """Interface of a cell to the runner.

    Each call raises ``StoppedError`` if it does not end as required.
    """

    def check(self, joints: Sequence[str], outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Check that everything that the file uses is present."""

    def posture(self, joints: Sequence[str]) -> list[float]:
        """Return the present joint values [rad]."""

    def follow(self, joints: Sequence[str], move: Row, points: Sequence[Row]) -> None:
        """Execute a goal to its end."""

    def cancel(self) -> None:
        """Cancel the present goal, without waiting."""

    def rests(self) -> bool:
        """Wait for the end of what was cancelled. Return whether it has ended."""

    def switch(self, name: str, on: bool) -> None:
        """Switch an output, and verify its value."""

    def wait_for(self, name: str, value: bool, seconds: float) -> None:
        """Wait for a value of an input."""

    def ask(self, text: str) -> None:
        """Ask the operator, who must answer yes."""

    def tell(self, text: str) -> None:
        """Show a text to the operator."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


def proven(folder: Path) -> list[Row]:
    """Return the rows of the single file of a result folder.

    Args:
        folder: Result folder.

    Raises:
        StoppedError: The file is not proven, or not the file that was proven.
    """
    try:
        proof = json.loads((folder / "proof.json").read_text("utf-8"))
        program_hashes = dict(proof["programs"])
        holds = proof["ok"] is True
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StoppedError(f"{folder}: no proof found ({type(error).__name__}: {error})") from error
    if not holds:
        raise StoppedError(f"{folder}: the proof does not hold")
    files = [name for name in program_hashes if name.endswith(".trajectory.jsonl")]
    if len(files) != 1 or len(program_hashes) != 1:
        raise StoppedError(
            f"{folder}: the proof names {', '.join(program_hashes) or 'nothing'}, required is one "
            "trajectory file"
        )
    content = (folder / "programs" / files[0]).read_bytes()
    if hashlib.sha256(content).hexdigest() != program_hashes[files[0]]:
        raise StoppedError(f"{files[0]} is not the file that was proven. Verify it again: tandem verify")
    rows = rows_of(content)
    if rows[0].get("problem_digest") != proof.get("problem_digest"):
        raise StoppedError(f"{files[0]} and the proof belong to different problems")
    _check_release(folder, proof.get("problem_digest"), program_hashes)
    return rows


def _check_release(folder: Path, digest: Any, named: dict[str, Any]) -> None:
    """Check a ``release.json`` of a service.

    The release must not be withdrawn, and must belong to these programs.

    Raises:
        StoppedError: It was withdrawn, or belongs to other programs.
    """
    for path in (folder / "release.json", folder / "programs" / "release.json"):
        if not path.is_file():
            continue
        try:
            data = json.loads(path.read_text("utf-8"))
            matches = data["digest"] == digest and dict(data["programs"]) == named
            valid = data["release"] is None or data["released"] is True
            status_text = "".join(char for char in str(data["says"]) if char.isprintable())
        except (ValueError, KeyError, TypeError) as error:
            raise StoppedError(f"{path}: not a valid release ({type(error).__name__}: {error})") from error
        if not matches:
            raise StoppedError(f"{path} belongs to other programs: {status_text}")
        if not valid:
            raise StoppedError(f"{path}: {status_text}")


def rows_of(content: bytes) -> list[Row]:
    """Return the rows of a file, after checking its last row, which contains their number and SHA-256.

    Raises:
        StoppedError: The file is incomplete, changed or of another version.
    """
    lines = content.decode("ascii").replace("\r\n", "\n").split("\n")
    if lines.pop() != "":
        raise StoppedError("the file is incomplete")
    rows: list[Row] = [json.loads(line) for line in lines]
    header, footer = rows[0], rows[-1]
    if header.get("tandem_trajectory") != VERSION:
        raise StoppedError(
            f"the file has format version {header.get('tandem_trajectory')}, this runner supports {VERSION}"
        )
    checksum = hashlib.sha256("".join(f"{line}\n" for line in lines[:-1]).encode("ascii")).hexdigest()
    if footer.get("end") != len(rows) or footer.get("sha256") != checksum:
        raise StoppedError("the rows do not match the number and checksum in the last row")
    return rows[:-1]


def steps(rows: Sequence[Row]) -> Iterator[tuple[Row, list[Row]]]:
    """Yield each step, a move together with its points."""
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
    """Run a file.

    Args:
        rows: Rows of the file.
        cell: Cell.

    Raises:
        StoppedError: It did not reach its end. All outputs that were on are off and the goal has ended, or
            the message states what is not.
    """
    joints = [name for row in rows if "arm" in row and "joints" in row for name in row["joints"]]
    outputs = list(dict.fromkeys(row["set"] for row in rows if "set" in row))
    inputs = list(dict.fromkeys(row["await"] for row in rows if "await" in row))
    on: list[str] = []
    row: Row = {}
    try:
        cell.check(joints, outputs, inputs)
        for row, points in steps(rows):
            _run_step(row, points, joints, cell, on)
    except BaseException as error:
        not_off, stopped = _stop_safely(cell, list(dict.fromkeys([*on, *row.get("on_failure", [])])))
        message = str(error) or type(error).__name__
        message += (
            f"; NOT SWITCHED OFF: {', '.join(not_off)}: switch off the power at once" if not_off else ""
        )
        message += (
            "" if stopped else "; THE ARMS MAY STILL MOVE: it is not confirmed that the goal was cancelled"
        )
        raise StoppedError(message) from error
    if on:
        _stop_safely(cell, on)
        raise StoppedError(f"{', '.join(on)} was still on at the end")


def _run_step(row: Row, points: Sequence[Row], joints: Sequence[str], cell: Cell, on: list[str]) -> None:
    key = next(iter(row))
    if key == "tell":
        cell.tell(row["tell"])
    elif key == "ask":
        cell.ask(row["ask"])
    elif key == "set":
        if row["to"]:
            on.append(row["set"])  # before switching: a switch that fails may still be on
        cell.switch(row["set"], bool(row["to"]))
        if not row["to"] and row["set"] in on:
            on.remove(row["set"])
    elif key == "await":
        cell.wait_for(row["await"], bool(row["to"]), row["within"])
    elif key == "dwell":
        cell.sleep(row["dwell"])
    elif key == "at":
        _check_start(row, joints, cell)
    elif key == "move":
        cell.follow(joints, row, points)
    elif key == "operation":
        held = f", the block is held by arm {row['held_by']}" if row["held_by"] else ""
        cell.tell(f"Operation {row['operation']}, setup {row['setup']}{held}.")
    elif key == "carry":
        cell.ask(_load_question(row))
    elif key == "tool":
        cell.tell(f"Arm {row['arm']} has {row['tool']}, {row['mass']:g} kg.")
    elif key != "arm":
        raise StoppedError(f"unknown row {key!r}")


def _load_question(row: Row) -> str:
    """Return the question for the operator when an arm takes or releases the block."""
    if not row["mass"]:
        return f"Arm {row['carry']} no longer holds a block: is its controller set to no load?"
    centre = ", ".join(f"{1000.0 * value:.1f}" for value in row["centre"])
    return (
        f"Arm {row['carry']} holds a block of {row['mass']:g} kg, its centre of mass at {centre} mm in the "
        "frame of the TCP: is its controller set to this load?"
    )


def _check_start(row: Row, joints: Sequence[str], cell: Cell) -> None:
    positions = cell.posture(joints)
    for name, actual, required in zip(joints, positions, row["at"]):
        if not abs(actual - required) <= row["within"]:  # NaN fails too
            raise StoppedError(
                f"{name} is at {actual:.5f} rad, required is {required:.5f} within {row['within']:g}: move "
                "the arms home by hand and restart from the beginning"
            )


def _stop_safely(cell: Cell, names: Sequence[str]) -> tuple[list[str], bool]:
    """Cancel the motion and switch outputs off.

    Returns:
        Outputs that may still be on, and whether the arms have stopped.
    """
    not_off, stopped = [], False
    with contextlib.suppress(BaseException):  # outputs must be switched off in any case
        cell.cancel()
    for name in names:
        try:
            cell.switch(name, False)
        except BaseException:  # the others must be switched off in any case
            not_off.append(name)
    with contextlib.suppress(BaseException):  # after the outputs: these must not wait for it
        stopped = cell.rests()
    return not_off, stopped


# ---- ROS 2 ----


class RosCell:
    """A cell in ROS 2: one action of a joint_trajectory_controller, services and topics."""

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
        node.create_subscription(JointState, "/joint_states", self._on_joint_state, 10)
        alive = node.create_publisher(Empty, f"{prefix}/alive", 1)
        node.create_timer(1.0 / ALIVE_HZ, lambda: alive.publish(Empty()))

    def _on_joint_state(self, message: Any) -> None:
        now = time.monotonic()
        self.states.update({name: (now, position) for name, position in zip(message.name, message.position)})

    def check(self, joints: Sequence[str], outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Check that all names exist, all joints are published, and no other runner is active."""
        from std_msgs.msg import Bool
        from std_srvs.srv import SetBool

        if not self.action.wait_for_server(timeout_sec=ANSWER_S):
            raise StoppedError("the controller's action is not available")
        for name in outputs:
            service = self.node.create_client(SetBool, f"{self.prefix}/{name}")
            if not service.wait_for_service(timeout_sec=ANSWER_S):
                raise StoppedError(f"the service {self.prefix}/{name} is not available")
            self.services[name] = service
        for name in inputs:
            self.node.create_subscription(
                Bool,
                f"{self.prefix}/{name}",
                lambda message, input_name=name: self.inputs.update({input_name: message.data}),
                1,
            )
        end = time.monotonic() + ANSWER_S
        while not all(name in self.states for name in joints):
            if time.monotonic() > end:
                missing = ", ".join(name for name in joints if name not in self.states)
                raise StoppedError(f"no states received of the joints {missing}")
            time.sleep(0.05)
        if self.node.count_publishers(f"{self.prefix}/alive") > 1:
            raise StoppedError(f"another runner is active: {self.prefix}/alive has another publisher")
        self.joints = joints

    def posture(self, joints: Sequence[str]) -> list[float]:
        """Return present joint values by name."""
        self._check_fresh(joints)
        return [self.states[name][1] for name in joints]

    def _check_fresh(self, joints: Sequence[str]) -> None:
        """Check that the states of joints are fresh."""
        now = time.monotonic()
        stale = [name for name in joints if now - self.states[name][0] > FRESH_S]
        if stale:
            raise StoppedError(f"no new states received of the joints {', '.join(stale)}")

    def follow(self, joints: Sequence[str], move: Row, points: Sequence[Row]) -> None:
        """Send a goal and wait for its end.

        A driver or controller that fails on the way reports nothing, but its joint states stop.
        """
        self.sent = self.action.send_goal_async(goal_of(joints, move, points))
        self.sent.add_done_callback(self._on_goal_response)
        handle = self._done(self.sent, ANSWER_S)
        if not handle.accepted:
            self.sent = None
            raise StoppedError("the controller rejected the goal")
        self.handle, self.ends = handle, handle.get_result_async()
        result = self._done(self.ends, points[-1]["t"] + move["goal_time"] + ANSWER_S, self.joints)
        if result.status != SUCCEEDED or result.result.error_code != 0:
            code, text = result.result.error_code, result.result.error_string
            raise StoppedError(f"the move failed: status {result.status}, error {code} {text}")
        self.sent = self.handle = self.ends = None

    def _on_goal_response(self, sent: Any) -> None:
        """Keep an accepted goal. A goal that is accepted after a stop is cancelled."""
        with contextlib.suppress(Exception):  # or this thread ends, which switches outputs off
            handle = sent.result()
            if handle.accepted and self.sent is sent:
                self.handle = handle
                if self.stopped:
                    self.cancelled = handle.cancel_goal_async()

    def cancel(self) -> None:
        """Cancel the goal, if there is one, and any that is accepted later."""
        self.stopped = True
        if self.handle is not None:
            self.cancelled = self.handle.cancel_goal_async()

    def rests(self) -> bool:
        """Report whether no goal is active, by the controller's own answers."""
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
        """Wait for a value on the topic of an input."""
        end = time.monotonic() + seconds
        while self.inputs.get(name) is not value:
            if time.monotonic() > end:
                raise StoppedError(f"{name} did not become {int(value)} within {seconds:g} s")
            time.sleep(0.01)

    def ask(self, text: str) -> None:
        """Ask at the terminal. Anything typed before the question is discarded."""
        with contextlib.suppress(Exception):  # no terminal, or another system
            import termios

            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        if input(f"{text} (yes) ").strip().lower() != "yes":
            raise StoppedError(f"not answered with yes: {text}")

    def tell(self, text: str) -> None:
        """Print a text at the terminal."""
        print(text)

    def sleep(self, seconds: float) -> None:
        """Wait."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._check_fresh(self.joints)
            time.sleep(min(left, LOOK_S))

    def _done(self, future: Any, seconds: float, joints: Sequence[str] = ()) -> Any:
        """Wait for the result of a future that another thread completes.

        Meanwhile check that the states of ``joints`` are fresh.
        """
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        end = time.monotonic() + seconds
        while not done.wait(min(LOOK_S, max(end - time.monotonic(), 0.0))):
            self._check_fresh(joints)
            if time.monotonic() >= end:
                raise StoppedError(f"no answer within {seconds:g} s")
        return future.result()


def goal_of(joints: Sequence[str], move: Row, points: Sequence[Row]) -> Any:
    """Return the goal of a move."""
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
            positions=list(map(float, row["q"])),  # JSON may have integers, ROS requires floats
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
"""Signals that stop the run. Closing or losing the terminal is a stop too."""


def stop(number: int, frame: Any) -> None:
    """Stop the run once. A second signal would prevent outputs from being switched off."""
    for signal_number in STOPS:
        signal.signal(signal_number, signal.SIG_IGN)
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Return 0 if the file reached its end."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("folder", type=Path, help="result folder of tandem plan")
    parser.add_argument("--controller", default="/joint_trajectory_controller")
    options = parser.parse_args(arguments)
    try:
        rows = proven(options.folder)
    except (StoppedError, OSError, ValueError) as error:
        print(f"nothing was done: {error}", file=sys.stderr)
        return 2
    import rclpy
    from rclpy.executors import MultiThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    # the handlers of rclpy would end the services on Ctrl-C, before outputs are switched off
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in STOPS:
        signal.signal(number, stop)
    node = rclpy.create_node("tandem_runner")
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    try:
        run(rows, RosCell(node, options.controller))
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
