"""What has changed between two sets of logs of one axis: machine, controller, and what two encoders see."""
