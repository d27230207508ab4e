"""Supply chain: packages that run on the robot, their licences, the bill of materials, known vulnerabilities."""
