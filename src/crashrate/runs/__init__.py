"""A campaign, a simulator and a store on disk: scenario files and resumable runs."""
