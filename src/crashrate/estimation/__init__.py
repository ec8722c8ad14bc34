"""The campaign, the 2017 procedure, and the estimate with its interval."""
