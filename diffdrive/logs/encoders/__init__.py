"""Two encoders of one axis, motor and table: what their difference says of the screw between them."""
