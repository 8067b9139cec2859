"""Two simulated UR controllers that run the texts of their programs tick by tick, with wires between them.

They are written for the tests from docs/urscript.md, independent of reader and writer. Time is counted in
ticks of 10 ms, and wires delay signals by some of them.
"""

from __future__ import annotations

import re

TICK = 0.01
"""A tick [s]."""
MOVEJ = 0.5
"""Time of a move by joints [s]."""
_OUT = re.compile(r"set_(standard|configurable)_digital_out\((\d),(True|False)\)")
_IN = re.compile(r"get_(standard|configurable)_digital_in\((\d)\)")
_BACK = re.compile(r"get_(standard|configurable)_digital_out\((\d)\)")


def _signal_number(match):
    return int(match[2]) + 8 * (match[1] == "configurable")


class Machine:
    """One controller: its program runs while ``running``; ``paused`` by hand or, if ``popups_pause``, while a
    popup holds it: then, and when it ends, its outputs fall but those that it ``keeps``. They stay low when
    a pause is over. ``move``: longest time of a move [s]; ``rises``: how often its output ``line`` rose."""

    def __init__(self, text, popups_pause=False, keeps=(), outputs=(), move=1e9, line=-1):
        rows = [row.partition("#")[0].strip() if '"' not in row else row.strip() for row in text.split("\n")]
        self.rows = [row for row in rows if row and not row.startswith("#") and " = p[" not in row]
        self.popups_pause, self.keeps, self.longest, self.line = popups_pause, set(keeps), move, line
        self.rises = 0
        self.high = set(outputs)
        self.functions, self.body = {}, []
        self._divide()
        self.running = self.paused = self.watching = False
        self.asked = self.why = ""
        self.told, self.seen = [], set()
        self.at = self.moves = self.done = 0
        self.until, self.moving, self.limit, self.wait = 0.0, "", 0.0, None

    def _divide(self):
        """Separate functions and the thread, by name, from the remaining rows."""
        depth, block = 0, []
        for row in self.rows[1:-1]:
            opens = bool(re.match(r"(def|thread|if|while)\b", row))
            if depth == 0 and not re.match(r"(def|thread)\b", row) and not block:
                if opens:
                    block = [row]
                    depth = 1
                elif " = [" not in row and not row.startswith("problem_digest"):
                    self.body.append(row)
                continue
            block.append(row)
            depth += opens - (row == "end")
            if depth == 0:
                head = re.match(r"(?:def|thread) (\w+)", block[0])
                if head:
                    self.functions[head[1]] = block
                else:
                    self.body.append(tuple(block))
                block = []

    # ---- what happens to it ----

    def start(self, now):
        self.running, self.paused, self.at, self.until = True, False, 0, now
        self.watching, self.asked, self.why, self.moving, self.wait = False, "", "", "", None
        self.rises = 0

    def fall(self):
        """Outputs fall as they are set to."""
        self.high = self.high & self.keeps

    def end(self, why):
        self.running, self.paused, self.asked, self.moving, self.why = False, False, "", "", why
        self.fall()

    def pause(self):
        self.paused = True
        self.fall()

    def answer(self):
        self.asked = ""
        self.at += 1

    # ---- a tick ----

    def tick(self, now, inputs):
        """One tick at ``now`` [s] with the inputs that are high."""
        if not self.running or self.paused:
            return
        held = bool(self.asked) and self.popups_pause
        if self.watching and not held:
            thread = self.functions["watch_partner"]
            runs, own = _signal_number(_IN.search(thread[1])), _BACK.search(thread[1])
            if runs not in inputs or (own and _signal_number(own) not in self.high):
                self._run_outputs(thread)
                self.end("watched")
                return
        if self.asked:
            return
        while self.running and not self.asked and now >= self.until:
            if self.moving:
                self.done += self.moving != "movej"
                self.moving = ""
            if self.at >= len(self.body):
                self.end("end")
                return
            if not self._statement(self.body[self.at], now, inputs):
                return

    def _run_outputs(self, block):
        for row in block:
            if found := _OUT.match(row):
                self._set(found)

    def _set(self, match):
        number = _signal_number(match)
        self.rises += number == self.line and match[3] == "True" and number not in self.high
        self.high = self.high | {number} if match[3] == "True" else self.high - {number}

    def _statement(self, row, now, inputs):
        """Do one statement; whether the next one may follow in the same tick."""
        if isinstance(row, tuple):
            found = re.match(r"if get_(standard|configurable)_digital_out\((\d)\)", row[0])
            if found and _signal_number(found) in self.high:
                self._run_outputs(row)
                self.end("stays high")
                return False
            self.at += 1
            return True
        if found := _OUT.match(row):
            self._set(found)
        elif found := re.match(r'popup\("([^"]*)","([^"]*)".*blocking=(True|False)', row):
            self.told.append(found[1])
            if found[3] == "True":
                self.asked = found[1]
                if self.popups_pause:
                    self.fall()
                return False
        elif found := re.match(r"(await_\w+)\((True|False),([\d.]+)\)", row):
            block = self.functions[found[1]]
            self.limit = now + float(found[3]) if self.wait is None else self.limit
            self.wait = row
            high = _signal_number(_IN.search(block[2])) in inputs
            lost = _signal_number(_BACK.search(block[3])) not in self.high
            if lost or high != (found[2] == "True"):
                if lost or now > self.limit:
                    self._run_outputs(block)
                    self.end("waited")
                return False
            self.wait = None
        elif found := re.match(r"check_partner\((True|False),(True|False)\)", row):
            block = self.functions["check_partner"]
            (line, runs), own = (
                (_signal_number(one) for one in _IN.finditer(block[1])),
                _BACK.search(block[1]),
            )
            expected = found[1] == "True", True, found[2] == "True"
            if (line in inputs, runs in inputs, _signal_number(own) in self.high) != expected:
                self._run_outputs(block)
                self.end("checked")
                return False
        elif row.startswith("watching = run"):
            self.watching = True
        elif row.startswith("kill"):
            self.watching = False
        elif found := re.match(r"(movej|movel|stand|sleep)\(.*?(?:t=)?([\d.]+)?(?:,r=[\d.]+)?\)$", row):
            seconds = (
                MOVEJ
                if found[1] == "movej"
                else float(re.search(r"t=([\d.]+)", row)[1])
                if "t=" in row
                else float(re.search(r"\(([\d.]+)\)", row)[1])
            )
            self.until = now + seconds
            if found[1] != "sleep":
                self.until = now + min(seconds, self.longest)
                self.moving = found[1]
                self.moves += found[1] != "movej"
            self.at += 1
            return False
        elif not row.startswith(("set_tcp", "set_payload")):
            raise ValueError(row)
        self.at += 1
        return True


class Pair:
    """Two machines and an operator. The first machine leads. Four wires have a delay of some ticks.

    The operator follows the instructions and answers within ``reply_delay`` [s].
    """

    def __init__(self, left, right, wires, delay, reply_delay=0.0):
        self.machines = (left, right)
        self.wires, self.delay = wires, delay
        """(from, output, to, input), from and to being 0 or 1."""
        self.now, self.past = 0.0, []
        self.cut = set()
        self.reply_delay, self.since = reply_delay, [0.0, 0.0]

    def tick(self, answers=True):
        self.past = [*self.past[-self.delay :], [set(m.high) for m in self.machines]]
        for i, machine in enumerate(self.machines):
            inputs = {
                into
                for k, (a, out, b, into) in enumerate(self.wires)
                if b == i and k not in self.cut and out in self.past[0][a]
            }
            machine.tick(self.now, inputs)
        self.now += TICK
        if answers:
            self.answer()

    def answer(self):
        lead, follow = self.machines
        if "Start the program of arm" in lead.asked and not follow.running and not follow.why:
            follow.start(self.now)
        ready = any("Ready to meet" in text for text in follow.told)
        for i, machine in enumerate(self.machines):
            gate = "say that it is ready" in machine.asked
            if not machine.asked or (gate and not ready):
                self.since[i] = self.now
            elif self.now >= self.since[i] + self.reply_delay:
                machine.answer()
                self.since[i] = self.now

    @property
    def ended(self):
        return all(machine.why for machine in self.machines)
