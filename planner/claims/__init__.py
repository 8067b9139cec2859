"""What must hold of a job, as data, and the sentences that planner and proof share."""
