/* What the old library did not have: why a call failed, how long answers may take, and our simulation's own calls. */
#ifndef NOMAD_H
#define NOMAD_H

#ifdef __cplusplus
extern "C" {
#endif

/* Why the last call that failed did, as it is said on stderr (there, that no robot is connected is said once until one
 * is); "" where none has failed. */
extern const char *nomad_last_error(void);

/* Whether errors are said on stderr: 1, as at the start, or 0. */
extern int nomad_verbose;

/* How long an answer may take in milliseconds: 0 for 5 s of a server and 1 s of a robot. zr, ws, special_request and
 * the arm have their own time beyond it. */
extern int nomad_timeout_ms;

/* The eight numbers of sim_truth: 1, ms, x, y (1/1000 inch), heading, turret (1/1000 degree), seed, robot's number. */
extern int nomad_sim_truth(long truth[8]);

/* Simulated time: 1 pause, 2 resume, 3 speed x 10, 4 step by ms. */
extern int nomad_sim_control(int verb, int value);

#ifdef __cplusplus
}
#endif

#endif
