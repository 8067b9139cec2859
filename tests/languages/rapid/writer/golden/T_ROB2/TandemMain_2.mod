MODULE TandemMain_2
  ! Written by Tandem 0.1.0 for task T_ROB2, ROB_2: ABB IRB 140-6/0.81.
  ! Arm right, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  PROC main()
    check_cell;
    ConfJ\On;
    ConfL\On;
    SingArea\Off;
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
    ! meet_2: left is at its first target
    WaitSyncTask meet_2,all_tasks;
    MoveAbsJ j_home\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_1_entry_1\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_1_start\NoEOffs,v_entry,fine,t_Holder;
    ! meet_3: right is at its first target
    WaitSyncTask meet_3,all_tasks;
    ! meet_4: the actions at this stop are done
    WaitSyncTask meet_4,all_tasks;
    SyncMoveOn block_1_on,all_tasks;
    approach;
    cut_front;
    SyncMoveOff block_1_off;
    ! meet_5: the actions at this stop are done
    WaitSyncTask meet_5,all_tasks;
    SyncMoveOn block_2_on,all_tasks;
    retreat;
    unmount;
    SyncMoveOff block_2_off;
    ! meet_6: the actions at this stop are done
    WaitSyncTask meet_6,all_tasks;
    MoveAbsJ j_1_entry_1\NoEOffs,v_entry,fine,t_Holder;
    MoveAbsJ j_home\NoEOffs,v_entry,fine,t_Holder;
    ! meet_7: right is home again
    WaitSyncTask meet_7,all_tasks;
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
