"""The networks of Table I and the recall heads, as torch modules."""
