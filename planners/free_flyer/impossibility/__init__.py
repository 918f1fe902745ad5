"""Why a task has no plan, told before anything is solved, by what every plan keeps."""
