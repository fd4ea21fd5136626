"""What trees and layers are worth for their coded bytes: curves, and their distance."""
