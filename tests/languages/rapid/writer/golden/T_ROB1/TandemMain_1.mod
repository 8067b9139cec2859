MODULE TandemMain_1
  ! Written by Tandem 0.1.0 for task T_ROB1, ROB_1: ABB IRB 140-6/0.81.
  ! Arm left, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  PROC main()
    check_cell;
    ConfJ\On;
    ConfL\On;
    SingArea\Off;
    SetDO doWirePower,0;
    UIMsgBox\Header:="Tandem","Is there NO wire between the arms? Each arm now goes"
        \MsgLine2:="home alone, then to its first position, alone or at"
        \MsgLine3:="once with the other one. Take off what joins them, see"
        \MsgLine4:="that their ways are clear, then press OK."
        \Buttons:=btnOK\Icon:=iconInfo;
    operation_1;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in main, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC

  PROC operation_1()
    ! Operation panel.
    ! meet_1: all tasks are ready for operation panel
    WaitSyncTask meet_1,all_tasks;
    MoveAbsJ j_home\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_1_entry_1\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_1_start\NoEOffs,v_entry,fine,t_Holder;
    ! meet_2: left is at its first target
    WaitSyncTask meet_2,all_tasks;
    ! meet_3: right is at its first target
    WaitSyncTask meet_3,all_tasks;
    TPWrite "Mount a wire of 812.5 mm, cold.";
    SetDO doWirePower,1;
    WaitTime 12.5;
    UIMsgBox\Header:="Tandem","Take up the slack at the slide, then press ""OK""."
        \Buttons:=btnOK\Icon:=iconInfo;
    ! meet_4: the actions at this stop are done
    WaitSyncTask meet_4,all_tasks;
    SyncMoveOn block_1_on,all_tasks;
    approach;
    cut_front;
    SyncMoveOff block_1_off;
    SetDO doWirePower,0;
    ! meet_5: the actions at this stop are done
    WaitSyncTask meet_5,all_tasks;
    SyncMoveOn block_2_on,all_tasks;
    retreat;
    unmount;
    SyncMoveOff block_2_off;
    UIMsgBox\Header:="Tandem","Take the wire off."
        \Buttons:=btnOK\Icon:=iconInfo;
    ! meet_6: the actions at this stop are done
    WaitSyncTask meet_6,all_tasks;
    ! meet_7: right is home again
    WaitSyncTask meet_7,all_tasks;
    MoveAbsJ j_1_entry_1\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_home\NoEOffs,v_entry,fine,t_Holder;
    ! meet_8: left is home again
    WaitSyncTask meet_8,all_tasks;
  ERROR
    SetDO doWirePower,0;
    StopMove\Quick;
    TPWrite "Tandem: error in operation_1, number "\Num:=ERRNO;
    TPWrite "The arms may be joined: move neither alone.";
    Stop\AllMoveTasks;
    EXIT;
  UNDO
    ! the program pointer was moved away
    SetDO doWirePower,0;
    SyncMoveUndo;
  ENDPROC
ENDMODULE
