"""What must hold of a job, as data, and the words that planner and proof share."""
