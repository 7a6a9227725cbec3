"""What the columns of an unknown trace are: from their names, their units, and what the numbers do."""
