"""The compiled searches of Flux Guided planning: rigid, fenced and free, on one trust-region step."""
