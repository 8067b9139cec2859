"""Many problems: worker processes, batches, comparisons, a cluster. No planning logic lives here."""
