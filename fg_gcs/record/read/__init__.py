"""Reading a recorded run back."""
