"""Reports of a trial: JSON, JUnit, tables, pages, explanations."""
