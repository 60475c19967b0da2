"""What has to be right before an arm learns: each check is a function of what was seen, and answers with a finding."""
