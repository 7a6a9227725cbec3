"""What is made of an explanation: by held-out data, by the command, by single events; the verdict."""
