"""The optimum over a whole recording: every measurement judged and weighed with its past and its future."""
