"""The machine: parameters, friction, plant, actuator, sensor."""
