/* The mine pump, written by hand for SPIN: a state is what lies between two turns.

   PERIOD is that of the rounds in milliseconds. What a turn read is forgotten at its end. */

#define NEVER 9 /* no previous state, and no message */
#define pass(elapsed, limit) elapsed = elapsed + PERIOD; \
    if :: elapsed > limit -> elapsed = limit + 1 :: else fi

#define OFF 0
#define ON 1
#define METHANE 2

#define REST 0
#define PUMPING 1
#define FAILED 2

#define QUIET 0
#define RINGING 1

#define AUTOMATIC 0
#define START 1
#define STOP 2

#define LOW 0
#define BETWEEN 1
#define HIGH 2

byte turn;
byte pump = OFF, pump_was = NEVER, watch = REST, watch_was = NEVER;
byte bell = RINGING, bell_was = NEVER;
int in_methane, in_pumping, in_ringing; /* milliseconds */
byte running = NEVER, failure = NEVER; /* the slots that machines read */
byte level, wish;
bit methane, monoxide;

inline sense_level() { if :: level = LOW :: level = BETWEEN :: level = HIGH fi }
inline sense_gas() {
  if :: methane = 0 :: methane = 1 fi;
  if :: monoxide = 0 :: monoxide = 1 fi
}
#define danger (methane || monoxide || seen)

active proctype mine() {
  bit seen;
  do
  :: atomic { turn == 0 ->
       if :: pump == METHANE && pump_was == METHANE -> pass(in_methane, 2000) :: else fi;
       if :: watch == PUMPING && watch_was == PUMPING -> pass(in_pumping, 5000) :: else fi;
       if :: bell == RINGING && bell_was == RINGING -> pass(in_ringing, 1000) :: else fi;
       sense_level();
       sense_gas();
       if :: wish = AUTOMATIC :: wish = START :: wish = STOP fi;
       if
       :: pump != pump_was && pump == OFF -> running = 0
       :: pump != pump_was && pump == ON -> running = 1
       :: else
       fi;
       pump_was = pump;
       if
       :: pump == OFF && methane -> pump = METHANE
       :: pump == OFF && !methane && (level == HIGH || (level == BETWEEN && wish == START)) ->
            pump = ON
       :: pump == ON && methane -> pump = METHANE; running = 0
       :: pump == ON && !methane && (level == LOW || (level == BETWEEN && wish == STOP)) ->
            pump = OFF; running = 0
       :: pump == METHANE && in_methane > 2000 && !methane -> pump = OFF; in_methane = 0
       :: else
       fi;
       level = 0; methane = 0; monoxide = 0; wish = 0; turn = 1 }
  :: atomic { turn == 1 ->
       sense_level();
       if
       :: watch != watch_was && watch == REST -> failure = 0
       :: watch != watch_was && watch == FAILED -> failure = 1
       :: else
       fi;
       watch_was = watch;
       if
       :: watch == REST && running == 1 && level == HIGH -> watch = PUMPING
       :: watch == PUMPING && (running != 1 || level != HIGH) -> watch = REST; in_pumping = 0
       :: watch == PUMPING && running == 1 && level == HIGH && in_pumping > 5000 ->
            watch = FAILED; in_pumping = 0
       :: watch == FAILED && level != HIGH -> watch = REST
       :: else
       fi;
       level = 0; turn = 2 }
  :: atomic { turn == 2 ->
       sense_gas();
       seen = (failure == 1);
       bell_was = bell;
       if
       :: bell == QUIET && danger -> bell = RINGING
       :: bell == RINGING && in_ringing > 1000 && !danger -> bell = QUIET; in_ringing = 0
       :: else
       fi;
       methane = 0; monoxide = 0; seen = 0; turn = 0 }
  od
}
