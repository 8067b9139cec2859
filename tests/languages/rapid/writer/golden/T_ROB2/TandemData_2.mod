MODULE TandemData_2
  ! Written by Tandem 0.1.0 for task T_ROB2, ROB_2: ABB IRB 140-6/0.81.
  ! Arm right, tool Holder. Written, not taught: plan again to change it.
  ! Problem test, SHA-256 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef.
  ! Proven: least clearance 12.3 mm (left/link_4 to stock).
  ! Error handlers switch doWirePower off first. An emergency stop runs no handler: wire the power so
  ! that it goes off with the motors.

  ! problem that this program was planned for; the proof starts from this digest
  CONST string problem_digest:="0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";
  ! base frame that the controller must have for this arm, in the world
  CONST pose base_frame:=[[1100.0000,0.0000,0.0000],[0.00000000,0.00000000,0.00000000,1.00000000]];

  ! tool and work objects
  TASK PERS tooldata t_Holder:=[TRUE,[[0.0000,0.0000,150.0000],[0.70710678,0.00000000,0.70710678,0.00000000]],[1.250,[0.000,0.000,60.000],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata w_stock:=[FALSE,TRUE,"",[[550.0000,0.0000,200.0000],[0.70710678,0.00000000,0.00000000,0.70710678]],[[0.0000,0.0000,0.0000],[1.00000000,0.00000000,0.00000000,0.00000000]]];

  ! moves from home to the first target and back
  CONST speeddata v_entry:=[250,45,250,45];
  CONST jointtarget j_home:=[[0.000000,0.000000,0.000000,0.000000,30.000000,0.000000],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget j_1_entry_1:=[[2.500000,10.000000,5.000000,7.500000,37.500000,-12.500000],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget j_1_start:=[[5.000000,20.000000,10.000000,15.000000,45.000000,-25.000000],[9E9,9E9,9E9,9E9,9E9,9E9]];

  ! zones sized for the distances of the targets
  CONST zonedata z3mm:=[FALSE,3,3,3,0.3000,3,0.3000];

  ! meeting points of the tasks; each is used once
  PERS tasks all_tasks{2}:=[["T_ROB1"],["T_ROB2"]];
  VAR syncident meet_1;
  VAR syncident meet_2;
  VAR syncident meet_3;
  VAR syncident meet_4;
  VAR syncident meet_5;
  VAR syncident meet_6;
  VAR syncident meet_7;
  VAR syncident meet_8;
  VAR syncident block_1_on;
  VAR syncident block_1_off;
  VAR syncident block_2_on;
  VAR syncident block_2_off;
ENDMODULE
