"""Programs that measure difffric and are no tests: studies of many made cases, kills, rates."""
