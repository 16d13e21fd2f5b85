"""The method, looked at: simulated buildings with a known truth, figures, and what each stage is worth."""
