/* Additions to the old library: error texts, reply time-outs, and calls for this project's simulator. */
#ifndef NOMAD_H
#define NOMAD_H

#ifdef __cplusplus
extern "C" {
#endif

/* Return the error text of the last failed call, "" if none has failed. The same text is printed to stderr (there, "no
 * robot is connected" is printed only once until a connection succeeds). */
extern const char *nomad_last_error(void);

/* Errors are printed to stderr if 1, which is the default, and not if 0. */
extern int nomad_verbose;

/* Reply time-out in milliseconds; 0, the default, means 5 s for a server and 1 s for a robot. zr, ws, special_request
 * and the arm have longer time-outs of their own. */
extern int nomad_timeout_ms;

/* The eight numbers of sim_truth: 1, ms, x, y (1/1000 inch), heading, turret (1/1000 degree), seed, robot number. */
extern int nomad_sim_truth(long truth[8]);

/* Return which person holds the robot (Stop on the page), "" if none does: its motions are then refused with error 7.
 * The text is valid until the next call. */
extern const char *nomad_held_by(void);

/* Simulated time: 1 pause, 2 resume, 3 speed x 10, 4 step by ms. */
extern int nomad_sim_control(int verb, int value);

#ifdef __cplusplus
}
#endif

#endif
