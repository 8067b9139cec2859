MODULE TandemCheck_2
  ! Written by Tandem 0.1.0 for task T_ROB2, ROB_2: ABB IRB 140-6/0.81.
  ! Arm right, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  PROC check_cell()
    VAR pose cfg_base;
    VAR num cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_pos_x",cfg_value;
    cfg_base.trans.x:=1000*cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_pos_y",cfg_value;
    cfg_base.trans.y:=1000*cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_pos_z",cfg_value;
    cfg_base.trans.z:=1000*cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_orient_u0",cfg_value;
    cfg_base.rot.q1:=cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_orient_u1",cfg_value;
    cfg_base.rot.q2:=cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_orient_u2",cfg_value;
    cfg_base.rot.q3:=cfg_value;
    ReadCfgData "/MOC/ROBOT/ROB_2","base_frame_orient_u3",cfg_value;
    cfg_base.rot.q4:=cfg_value;
    check_pose "Base of arm right",cfg_base,base_frame;
    check_pose "Frame of t_Holder",t_Holder.tframe,[[0.0000,0.0000,150.0000],[0.70710678,0.00000000,0.70710678,0.00000000]];
    check_true "Holder of t_Holder",t_Holder.robhold;
    check_pose "Object frame of w_stock",w_stock.oframe,[[0.0000,0.0000,0.0000],[1.00000000,0.00000000,0.00000000,0.00000000]];
    check_pose "User frame of w_stock",w_stock.uframe,[[550.0000,0.0000,200.0000],[0.70710678,0.00000000,0.00000000,0.70710678]];
    check_true "Holder of w_stock",NOT w_stock.robhold AND w_stock.ufprog;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in check_cell, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC

  ! small rotation angle: twice the distance of the quaternions, in degrees
  PROC check_pose(string what,pose got,pose wanted)
    VAR num off_sign:=1;
    VAR num off_turn;
    IF got.rot.q1*wanted.rot.q1+got.rot.q2*wanted.rot.q2+got.rot.q3*wanted.rot.q3+got.rot.q4*wanted.rot.q4<0 THEN
      off_sign:=-1;
    ENDIF
    off_turn:=114.591559*Sqrt(Pow(got.rot.q1-off_sign*wanted.rot.q1,2)+Pow(got.rot.q2-off_sign*wanted.rot.q2,2)
      +Pow(got.rot.q3-off_sign*wanted.rot.q3,2)+Pow(got.rot.q4-off_sign*wanted.rot.q4,2));
    IF Distance(got.trans,wanted.trans)>0.1 OR off_turn>0.02 THEN
      TPWrite what;
      TPWrite "deviates by [mm]"\Num:=Distance(got.trans,wanted.trans);
      TPWrite "and is rotated by [degrees]"\Num:=off_turn;
      check_stop;
    ENDIF
  ENDPROC

  PROC check_true(string what,bool same)
    IF NOT same THEN
      TPWrite what;
      TPWrite "differs from the plan.";
      check_stop;
    ENDIF
  ENDPROC

  ! a restart stays in this loop
  PROC check_stop()
    TPWrite "No arm moves. Correct the cell,";
    TPWrite "then PP to main in all tasks.";
    WHILE TRUE DO
      Stop\AllMoveTasks;
    ENDWHILE
  ENDPROC
ENDMODULE
