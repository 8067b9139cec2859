"""What people look at: report, setup sheet, replay."""
