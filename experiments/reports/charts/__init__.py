"""What one zooms into on a page: signals, missing force, frequency responses, distributions; each as a `Chart`."""
