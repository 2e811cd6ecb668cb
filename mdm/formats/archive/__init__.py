"""Archives of arrays, `.npz`, of mdm's own: models and policies of every kind, with their names; and durations."""
