"""What needs both wings."""
