"""A KRL program written by hand after docs/krl.md, whole and in parts, in both dialects."""

from planner.languages.krl.reader import reader
from planner.programs.signals import NumberedSignals

HEAD = "&ACCESS RVP\r\n&REL 1\r\n"
OUTER = "E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0"
LOAD = (
    "{M 1.250,CM {X 0.000,Y 0.000,Z 60.000,A 0.000000,B 0.000000,C 0.000000},"
    "J {X 0.000000,Y 0.000000,Z 0.000000}}"
)
DAT = f"""DEFDAT wall PUBLIC
; what it is for
DECL CHAR problem_digest[64]
problem_digest[]="ab12"
DECL FRAME base_frame={{X 0.0000,Y 0.0000,Z 500.0000,A 90.000000,B 0.000000,C 0.000000}}
DECL FRAME t_mill={{X 0.0000,Y 0.0000,Z 150.0000,A 0.000000,B 90.000000,C 0.000000}}
DECL LOAD l_mill={LOAD}
DECL FRAME b_stock={{X 900.0000,Y 0.0000,Z 200.0000,A 90.000000,B 0.000000,C 0.000000}}
DECL E6AXIS x_home={{A1 0.000000,A2 -90.000000,A3 90.000000,A4 0.000000,A5 30.000000,A6 0.000000,{OUTER}}}
DECL E6POS p_1_start={{X -12.0000,Y 40.0000,Z 210.0000,A 12.50000,B 80.00000,C -4.00000,S 2,T 35,{OUTER}}}
ENDDAT
"""
OLD_VARIABLES = "DECL REAL tm_shift,tm_turn\n"
VARIABLES = f"""DECL KrlMsg_T tm_msg
DECL KrlMsgPar_T tm_par[3]
DECL KrlMsgOpt_T tm_opt
DECL KrlMsgDlgSK_T tm_key[7]
DECL INT tm_ticket,tm_state,tm_answer
DECL BOOL tm_gone
{OLD_VARIABLES}"""
INTERRUPT = """GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
"""
EMPTY = "".join(
    f"tm_{kind}[{i}]={{{word} #EMPTY}}\n"
    for kind, word, numbers in (("par", "Par_Type", range(1, 4)), ("key", "SK_type", range(3, 8)))
    for i in numbers
)
OPTIONS = f"tm_opt={{VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}}\n{EMPTY}"
ROBROOT_CHECK = """tm_shift=SQRT($ROBROOT.X*$ROBROOT.X+$ROBROOT.Y*$ROBROOT.Y+$ROBROOT.Z*$ROBROOT.Z)
tm_turn=ABS($ROBROOT.A)+ABS($ROBROOT.B)+ABS($ROBROOT.C)
"""
OLD_FOOT = f"""{ROBROOT_CHECK}WHILE (tm_shift>0.1) OR (tm_turn>0.02)
HALT
{ROBROOT_CHECK}ENDWHILE
"""


def message(text):
    """The row that sets the text of a message."""
    return f'tm_msg={{Modul[] "Tandem",Nr 1,Msg_txt[] "{text}"}}\n'


def notify(text):
    """A note on the panel."""
    return f"{message(text)}tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)\n"


FOOT = f"""{ROBROOT_CHECK}WHILE (tm_shift>0.1) OR (tm_turn>0.02)
tm_par[1].Par_Type=#VALUE
tm_par[1].Par_Real=tm_shift
tm_par[2].Par_Type=#VALUE
tm_par[2].Par_Real=tm_turn
{notify("Arm left: $ROBROOT is off zero by %1 mm, %2 deg")}HALT
{ROBROOT_CHECK}ENDWHILE
tm_par[1].Par_Type=#EMPTY
tm_par[2].Par_Type=#EMPTY
"""


def dialog(text, yes="Yes", no="No"):
    """A dialog as docs/krl.md has it."""
    other = f'{{SK_type #VALUE,SK_txt[] "{no}"}}' if no else "{SK_type #EMPTY}"
    return f"""tm_answer=0
WHILE tm_answer<>1
{message(text)}tm_key[1]={{SK_type #VALUE,SK_txt[] "{yes}"}}
tm_key[2]={other}
tm_ticket=Set_KrlDlg(tm_msg,tm_par[],tm_key[],tm_opt)
WHILE Exists_KrlDlg(tm_ticket,tm_answer)
WAIT SEC 0.1
ENDWHILE
WAIT SEC 0.1
ENDWHILE
"""


NOT_EXTERNAL = "WHILE $MODE_OP==#EX\nHALT\nENDWHILE\n"
QUESTIONS = dialog("Is the stock in place", "Next", "") + dialog("and the way of the arm clear?")
MAIN = f"""DEF wall()
{VARIABLES}{INTERRUPT}BAS(#INITMOV,0)
$ADVANCE=3
$IPO_MODE=#BASE
$ORI_TYPE=#VAR
$OUT[17]=FALSE ; doSpindle
{OPTIONS}{FOOT}{QUESTIONS}$TOOL=t_mill
$LOAD=l_mill
$BASE=b_stock
$VEL_AXIS[1]=12
$VEL_AXIS[2]=12
$VEL_AXIS[3]=12
$VEL_AXIS[4]=12
$VEL_AXIS[5]=12
$VEL_AXIS[6]=12
PTP x_home
PTP p_1_start
{notify("The spindle starts.")}$OUT[17]=TRUE
WAIT SEC 2.5
wall_1()
$OUT[17]=FALSE
PTP x_home
END
"""
OLDER = (
    MAIN.replace(VARIABLES, "EXT BAS (BAS_COMMAND :IN,REAL :IN )\nEXT wall_1()\n" + OLD_VARIABLES)
    .replace(OPTIONS + FOOT, NOT_EXTERNAL + OLD_FOOT)
    .replace(QUESTIONS, ";? Is the stock in place\n;? and the way of the arm clear?\nHALT\n" + NOT_EXTERNAL)
    .replace(notify("The spindle starts."), ";* The spindle starts.\n")
)
"""The same program for the older dialect."""
MOVES = """DEF wall_1()
; Segment approach: 2 moves, 1.50 s.
$VEL.CP=0.02000000
$VEL.ORI1=200.0
$VEL.ORI2=200.0
$APO.CDIS=0.3
$APO.CORI=180.0
SLIN {X -2.0000,Y 40.0000,Z 210.0000,A 12.50000,B 80.00000,C -4.00000} C_SPL
; Segment cut/front: 2 moves, 0.9 s.
$VEL.CP=0.01000000
$VEL.ORI1=10.0
$VEL.ORI2=10.0
SLIN {X -2.0000,Y 40.0000,Z 210.0000,A 42.50000,B 80.00000,C -4.00000}
WAIT SEC 0.25
SLIN {X -2.0000,Y 30.0000,Z 210.0000,A 42.50000,B 80.00000,C -4.00000}
END
"""


def texts(**changed):
    """Files of one arm; ``changed`` {dat, main, moves: text}."""
    parts = {"dat": DAT, "main": MAIN, "moves": MOVES} | changed
    names = {"dat": "wall.dat", "main": "wall.src", "moves": "wall_1.src"}
    return {f"left/{names[k]}": HEAD + text.replace("\n", "\r\n") for k, text in parts.items() if text}


def read(dialect="krc4", **changed):
    return reader.read(texts(**changed), 100_000, dialect)


def steps(dialect="krc4", **changed):
    text = read(dialect, **changed)
    assert text.faults == ()
    signals = NumberedSignals({17: "doSpindle"}, {5: "diPartner"})
    return reader.main_flow(text, text.base, signals, "left", ["right"])[0]


def kinds(**changed):
    return {fault.kind for fault in read(**changed).faults}


WAIT = """$TIMER[1]=0
$TIMER_STOP[1]=FALSE
WHILE $IN[5]==FALSE
IF $TIMER[1]>30000 THEN
; Arm right did not answer in time. Start repeats the wait.
HALT
$TIMER[1]=0
ENDIF
WAIT SEC 0.01
ENDWHILE
$TIMER_STOP[1]=TRUE
"""
