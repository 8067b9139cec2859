MODULE TandemCut1_2
  ! Written by Tandem 0.1.0 for task T_ROB2, ROB_2: ABB IRB 140-6/0.81.
  ! Arm right, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  PROC approach()
    ! Segment approach: 2 moves, 1 s.
    MoveL [[-96.0805,25.9885,97.3258],[0.36074347,0.68957676,-0.42319623,0.46395365],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=1,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[-102.4059,27.0860,97.5437],[0.35822888,0.69280954,-0.41721046,0.46650021],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=2,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
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
    MoveL [[-108.7630,28.1067,97.7552],[0.35568645,0.69601109,-0.41118990,0.46901874],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=3,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[-115.1506,29.0500,97.9603],[0.35311629,0.69918097,-0.40513476,0.47150893],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=4,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[-121.5677,29.9153,98.1591],[0.35051854,0.70231875,-0.39904525,0.47397048],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=5,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
    MoveL [[-128.0132,30.7020,98.3516],[0.34789332,0.70542398,-0.39292158,0.47640306],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=6,v20\T:=0.50000,fine,t_Holder\WObj:=w_stock;
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
    MoveL [[-134.4861,31.4097,98.5378],[0.34524076,0.70849623,-0.38676398,0.47880636],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=7,v20\T:=0.50000,z3mm,t_Holder\WObj:=w_stock;
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
    MoveL [[-140.9852,32.0376,98.7178],[0.34256100,0.71153506,-0.38057266,0.48118008],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=8,v20\T:=0.50000,fine,t_Holder\WObj:=w_stock;
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
