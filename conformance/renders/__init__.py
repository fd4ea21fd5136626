"""Render conformance: golden pictures of small streams, and who draws them right."""
