"""All laws, or all velocity estimators, on the same task."""
