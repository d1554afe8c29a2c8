"""Parts that tasks with an object on a table share."""
