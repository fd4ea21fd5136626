"""How far scenes are from one another: in numbers, in pictures, and as a page for a browser."""
