"""Language models as pilots: prompts, the endpoint, answers, runs that can be resumed, reports."""
