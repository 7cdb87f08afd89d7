"""What needs acquisition and analysis together: the worker of a lab, studies, sealed trials and the demo."""
