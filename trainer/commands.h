/* Sub-commands of oriel-train. Each parses its own options (getopt_long; argv[0] is the sub-command's name) and returns the exit code: 0 done, 1 bad input, 2 usage. */
#ifndef TRAINER_COMMANDS_H
#define TRAINER_COMMANDS_H
int cmd_fit(int argc, char **argv);
int cmd_sky(int argc, char **argv);
int cmd_eval(int argc, char **argv);
int cmd_masks(int argc, char **argv);
int cmd_mesh(int argc, char **argv);
int cmd_bench(int argc, char **argv);
int cmd_report(int argc, char **argv);
int cmd_plot(int argc, char **argv);

/* A string in quotes on standard output, escaped as JSON wants it. */
void print_json_string(const char *s);
#endif
