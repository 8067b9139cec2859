"""Small RAPID programs for the reader's tests, and the reader's messages about them."""

from __future__ import annotations

from planner.languages.rapid.reader.flow import main_steps
from planner.languages.rapid.reader.reader import read_task

HEAD = """MODULE Left
  ! made for a test
  TASK PERS tooldata holder:=[TRUE,[[0,0,120.5],[0.7071068,0,0.7071068,0]],[0.8,[0,0,60],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata block:=[FALSE,TRUE,"",[[500,0,300],[1,0,0,0]],[[0,0,10],[1,0,0,0]]];
  PERS tasks both{2}:=[["T_ROB1"],["T_ROB2"]];
  CONST speeddata slow:=[25,500,5000,1000];
  CONST zonedata small:=[FALSE,0.5,0.5,0.5,0.05,0.5,0.05];
  CONST robtarget above:=[[1,2,3],[1,0,0,0],[0,-1,2,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget home:=[[0,-10.5,20,0,30,180],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST num pause:=2*1.5;
  VAR num answer;
  VAR bool late:=FALSE;
  VAR syncident sync1;
  VAR syncident sync2;
"""
MOVE = (
    r"MoveL [[10.5,-2,3],[0,1,0,0],[0,0,-1,1],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    r"\ID:=10, v100\T:=0.25, z1, holder\WObj:=block;"
)


def program(body: str, more: str = "", data: str = "") -> str:
    return f"{HEAD}{data}\n  PROC main()\n{body}\n  ENDPROC\n{more}\nENDMODULE\n"


def faults(text: str, **options: object) -> list[tuple[int, str]]:
    task = read_task({"left.mod": text}, **options)  # type: ignore[arg-type]
    return [(fault.line, fault.code) for fault in task.faults]


def codes(text: str) -> set[str]:
    return {code for _, code in faults(text)}


def steps(text: str) -> tuple[object, ...]:
    task = read_task({"left.mod": text})
    assert task.faults == ()
    return main_steps(task.modules)


FULL = program(
    r'''
    ConfL\On;
    SingArea\Wrist;
    AccSet 60, 60;
    MoveAbsJ home\NoEOffs, v50, fine, tool0;
    TPErase;
    TPWrite "ready " \Num:=pause;
    UIMsgBox \Header:="Mount", "the wire" \MsgLine2:="""quoted"""
      \Buttons:=btnOKCancel \Icon:=iconInfo \Result:=answer;
    IF answer <> resOK THEN
      Stop;
    ENDIF
    WaitSyncTask sync1, both;
    SyncMoveOn sync2, both\TimeOut:=60;
    cut;
    SyncMoveOff sync2;
    WaitTime \InPos, pause;
    WaitDI di_ready, 1\MaxTime:=5\TimeFlag:=late;
    Load \Dynamic, diskhome \File:="part1.mod";
    %"Left:cut"%;
    UnLoad "HOME:/part1.mod";
    FOR i FROM 1 TO 3 DO
      Set do_lamp;
    ENDFOR
  ERROR
    StopMove\Quick;
    SetDO do_wire, 0;
    IF IsSyncMoveOn() SyncMoveUndo;
    IF ERRNO = ERR_WAIT_MAXTIME THEN
      RETRY;
    ELSE
      EXIT;
    ENDIF''',
    f"""  LOCAL PROC cut()
    {MOVE}
    SetDO \\Sync, do_wire, 1;
    movej above\\ID:=20, [25,500,5000,1000]\\V:=25, small, HOLDER\\wobj:=block;
  ENDPROC""",
)
