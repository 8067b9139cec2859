MODULE TandemCut1_1
  ! Written by Tandem 0.1.0 for task T_ROB1, ROB_1: ABB IRB 140-6/0.81.
  ! Arm left, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  PROC approach()
    ! Segment approach: 2 moves, 1 s.
    MoveL [[97.3430,-26.2141,97.3699],[0.46446519,-0.42200187,-0.69022579,-0.36024279],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=1,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[104.9450,-27.5035,97.6291],[0.46751100,-0.41480640,-0.69409393,-0.35721524],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=2,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in approach, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC

  PROC cut_front()
    ! Segment cut/front: 4 moves, 2 s.
    MoveL [[112.5919,-28.6820,97.8791],[0.47051628,-0.40756096,-0.69791685,-0.35414767],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=3,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[120.2819,-29.7485,98.1199],[0.47348047,-0.40026589,-0.70169378,-0.35104030],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=4,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[128.0132,-30.7020,98.3516],[0.47640306,-0.39292158,-0.70542398,-0.34789332],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=5,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[135.7838,-31.5416,98.5743],[0.47928348,-0.38552840,-0.70910668,-0.34470698],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=6,v20\T:=0.50000,fine,t_Holder\WObj:=w_stock;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in cut_front, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC

  PROC retreat()
    ! Segment retreat: 1 moves, 0.5 s.
    MoveL [[143.5920,-32.2664,98.7881],[0.48212121,-0.37808675,-0.71274114,-0.34148151],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=7,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in retreat, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC

  PROC unmount()
    ! Segment unmount: 1 moves, 0.5 s.
    MoveL [[151.4357,-32.8753,98.9930],[0.48491570,-0.37059702,-0.71632659,-0.33821715],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=8,v20\T:=0.50000,fine,t_Holder\WObj:=w_stock;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in unmount, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC
ENDMODULE
