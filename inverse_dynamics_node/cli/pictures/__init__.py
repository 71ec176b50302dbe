"""Pictures of the results of the commands."""
